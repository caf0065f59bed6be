"""The prior against the original's sampler written out in the test, with diffusers' DDIM with eta 1."""

import json
import math
import os
import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from ia_bench.cli.check import main as check
from ia_bench.common.errors import InputError
from ia_bench.common.seeds import derive_seed
from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench.priors.contract import COMPONENTS, Observations
from ia_bench.priors.diffusion.encoding import Frame
from ia_bench.priors.inputs import content_number
from ia_bench.priors.original import IntrinsicAnythingPrior, Networks, encode, pull


def photographs(count: int = 2, side: int = 32) -> Observations:
    """Pictures that fill their frame, at the networks' size: nothing is cropped or resampled."""
    images = torch.rand(count, side, side, 3, generator=torch.Generator().manual_seed(7))
    return Observations(images, torch.ones(count, side, side))


@torch.no_grad()
def original_sample(networks: Networks, image: Tensor, seed: int, steps: int) -> Tensor:
    """One sample (S, S, 3), linear, of one picture, as the release samples; the last step returns the estimate itself."""
    import_torchvision()
    from diffusers import DDIMScheduler

    # The release does not clip and has set_alpha_to_one False: docs/original_weights.md. Random networks reach the clip.
    schedule = DDIMScheduler(1000, 0.00085, 0.012, "scaled_linear", clip_sample_range=20, set_alpha_to_one=True, steps_offset=1)
    schedule.set_timesteps(steps)
    generator = torch.Generator().manual_seed(seed)
    encoded = image.movedim(-1, 0)[None] ** (1 / 2.2)
    latents = networks.vae.encode(2 * encoded - 1).latent_dist.mode()  # not scaled
    side = networks.clip.config.image_size
    seen = F.interpolate(encoded, (side, side), mode="bicubic", align_corners=True)
    mean, deviation = torch.tensor([0.48145466, 0.4578275, 0.40821073]), torch.tensor([0.26862954, 0.26130258, 0.27577711])
    token = networks.clip(pixel_values=(seen - mean[:, None, None]) / deviation[:, None, None]).image_embeds[:, None]
    x = torch.randn(latents.shape[1:], generator=generator)[None]
    for t in schedule.timesteps:
        eps = networks.unet(torch.cat([x, latents], 1), t, token).sample
        noise = torch.randn(latents.shape[1:], generator=generator)[None] if t != schedule.timesteps[-1] else None
        x = schedule.step(eps, t, x, eta=1.0, use_clipped_model_output=True, variance_noise=noise).prev_sample
    decoded = networks.vae.decode(x / 0.18215).sample
    return (decoded[0].movedim(0, -1) / 2 + 0.5).clamp(0, 1) ** 2.2


def test_samples_are_the_originals(weights: Path) -> None:
    shown = photographs()
    images, masks = shown.images, shown.masks
    drawn = IntrinsicAnythingPrior(weights=str(weights), steps=4).sample(shown, seed=5)
    samples = drawn.values
    assert drawn.cost["network_calls"] == 2 * 2 * 4  # components, images, steps
    for number, component in enumerate(COMPONENTS):
        networks = Networks(weights / component, torch.device("cpu"))
        for view in range(2):
            seed = derive_seed(5, number, content_number(images[view], masks[view]))
            expected = original_sample(networks, images[view], seed, 4)
            torch.testing.assert_close(samples[component][view], expected, atol=2e-4, rtol=0)
    assert float((samples["albedo"][0] - samples["albedo"][1]).abs().mean()) > 0.05


def test_conformance(weights: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert check(["prior=intrinsicanything", f"prior.options.weights={weights}", "prior.options.steps=2"]) == 0
    assert " passed, 0 failed, 0 skipped" in capsys.readouterr().out


def test_guidance_draws_nearer_the_stronger_it_is_and_stays_in_range(weights: Path) -> None:
    shown = photographs(1)
    target = {"albedo": 0.3 * shown.images + 0.2}
    distances = []
    for strength in (0.0, 3.0, 30.0, 1000.0):
        prior = IntrinsicAnythingPrior(weights=str(weights), steps=5, guidance_strength=strength)
        drawn = prior.sample(shown, seed=0, guidance=target)
        sample = drawn.values["albedo"]
        assert bool(((sample >= 0) & (sample <= 1)).all())
        distances.append(float((sample - target["albedo"]).abs().mean()))
        assert drawn.cost["guided_estimates"] == (5 if strength else 0)
    assert distances == sorted(distances, reverse=True)
    assert distances[-1] < 0.9 * distances[0]


def test_provides_what_was_converted_and_is_told_by_what_decides_samples(weights: Path, tmp_path: Path) -> None:
    shutil.copytree(weights, tmp_path / "copy")
    shutil.copytree(weights / "albedo", tmp_path / "albedo")
    assert IntrinsicAnythingPrior(weights=str(weights)).info.provides == {"albedo", "specular"}
    prior = IntrinsicAnythingPrior(weights=str(tmp_path))
    assert prior.info.provides == {"albedo"}
    assert prior.info.resolution == 32

    def fingerprint(**options: object) -> str:
        return IntrinsicAnythingPrior(**{"weights": str(weights), **options}).fingerprint

    assert fingerprint() == fingerprint(weights=str(tmp_path / "copy"), batch=2)
    record = tmp_path / "copy" / "albedo" / "source.json"
    record.write_text(json.dumps({**json.loads(record.read_text()), "sha256": "0" * 64}))
    others = [{"steps": 3}, {"eta": 0.5}, {"guidance_strength": 1.0}, {"weights": tmp_path}, {"weights": tmp_path / "copy"}]
    assert len({fingerprint(), *(fingerprint(**other) for other in others)}) == 1 + len(others)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (
            lambda folder: os.truncate(folder / "vae" / "diffusion_pytorch_model.safetensors", 100_000),
            r"vae: expected converted weights, found: .*",
        ),
        (lambda folder: shutil.rmtree(folder / "image_encoder"), r"image_encoder: expected converted weights, found: .*"),
        (lambda folder: (folder / "scheduler" / "scheduler_config.json").unlink(), r"scheduler_config.json: "),
        (shutil.rmtree, "prior.options.weights=.*: expected albedo/source.json or specular/source.json"),
    ],
)
def test_damaged_weights(damage: Callable[[Path], object], message: str, weights: Path, tmp_path: Path) -> None:
    shutil.copytree(weights / "albedo", tmp_path / "albedo")
    damage(tmp_path / "albedo")
    with pytest.raises(InputError, match=message):
        IntrinsicAnythingPrior(weights=str(tmp_path)).sample(photographs(1), seed=0)


def test_encoding_is_gamma_on_white() -> None:
    """At the networks' own size nothing is resampled, so every pixel follows from the definition."""
    mask = torch.ones(64, 64)
    mask[10, 20], mask[11, 20] = 0.0, 0.4
    colour = torch.rand(64, 64, 3, generator=torch.Generator().manual_seed(0)) * 1.5  # up to 1.5: clipped
    square = encode(colour * mask[..., None], mask, Frame.around(mask, 64, margin=0))
    expected = colour.double().clamp(0, 1) ** (1 / 2.2)
    expected[10, 20] = 1
    np.testing.assert_allclose(square.movedim(0, -1), expected, atol=1e-6)
    mask[:, :16] = 0  # an object of 64 x 48 fills the square's height, white on both sides
    square = encode(colour * mask[..., None], mask, Frame.around(mask, 64, margin=0))
    assert bool((square[..., :8] == 1).all())
    np.testing.assert_allclose(square[..., 8:].movedim(0, -1)[:, :48], expected[:, 16:], atol=1e-6)


def decoder(latents: Tensor) -> Tensor:
    """Something smooth, not linear, from (N, 2, 3, 3) to (N, 3, 4, 4) in [0, 1]."""
    generator = torch.Generator().manual_seed(5)
    matrix = torch.randn(18, 48, generator=generator, dtype=torch.float64) / 4
    return torch.sigmoid(latents.flatten(1).double() @ matrix).unflatten(1, (3, 4, 4))


def draws(*shape: int, seed: int) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.mark.parametrize("alpha_bar", [0.0048, 0.3, 0.998])
def test_small_strengths_are_the_original_step(alpha_bar: float) -> None:
    """There: eps' = eps + gamma d/dx_t |D((x_t - b eps) / a) - y|, with eps held constant, and x_0 from eps'."""
    a, b, gamma = math.sqrt(alpha_bar), math.sqrt(1 - alpha_bar), 1e-3
    noisy, eps, target = draws(4, 2, 3, 3, seed=1), draws(4, 2, 3, 3, seed=2), torch.sigmoid(draws(4, 3, 4, 4, seed=3))
    noisy.requires_grad_()
    distance = torch.stack([torch.linalg.norm(one) for one in decoder((noisy - b * eps) / a) - target])
    (score,) = torch.autograd.grad(distance.sum(), noisy)
    expected = ((noisy - b * (eps + gamma * score)) / a).detach()
    cost = Counter()
    found = pull(((noisy - b * eps) / a).detach(), target, decoder, gamma, alpha_bar, cost)
    torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-9)
    assert cost == {"guided_estimates": 4, "guided_cut": 0}
    assert not found.requires_grad


@pytest.mark.parametrize("strength", [3.0, 1000.0, 1e30])
def test_long_steps_end_where_a_linear_decoder_reaches_the_render(strength: float) -> None:
    cost = Counter()
    x0, target = draws(3, 3, 4, 4, seed=1), draws(3, 3, 4, 4, seed=2)
    guided = pull(x0, target, lambda latents: 0.5 * latents, strength, 1e-4, cost)  # b / a^2 = 10^4
    torch.testing.assert_close(0.5 * guided, target, rtol=1e-9, atol=1e-9)
    assert cost == {"guided_estimates": 3, "guided_cut": 3}
