"""The prior against the original's sampler written out in the test: plain-torch networks, diffusers' DDIM with eta 1."""

from __future__ import annotations

import json
import math
import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from ldm import LatentDiffusion
from torch import Tensor

from ia_bench.cli.check import main as check
from ia_bench.common.errors import InputError
from ia_bench.common.registry import built_in, create
from ia_bench.common.seeds import derive_seed
from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench.priors.contract import COMPONENTS, Observations
from ia_bench.priors.inputs import content_number
from ia_bench.priors.original import Crop, IntrinsicAnythingPrior, decode, encode, pull


def photographs(count: int = 2, side: int = 32) -> Observations:
    """Pictures that fill their frame, at the networks' size: nothing is cropped or resampled."""
    images = torch.rand(count, side, side, 3, generator=torch.Generator().manual_seed(7))
    return Observations(images, torch.ones(count, side, side))


@torch.no_grad()
def original_sample(model: LatentDiffusion, image: Tensor, seed: int, steps: int) -> Tensor:
    """One sample (S, S, 3), linear, of one picture, as the release samples; the last step returns the estimate itself."""
    import_torchvision()
    from diffusers import DDIMScheduler

    # The release does not clip and has set_alpha_to_one False: docs/original_weights.md. Random networks reach the clip.
    schedule = DDIMScheduler(1000, 0.00085, 0.012, "scaled_linear", clip_sample_range=20, set_alpha_to_one=True, steps_offset=1)
    schedule.set_timesteps(steps)
    generator = torch.Generator().manual_seed(seed)
    encoded = image.movedim(-1, 0)[None] ** (1 / 2.2)
    latents = model.first_stage_model.mode(2 * encoded - 1)  # not scaled
    visual = model.cond_stage_model.model.visual
    seen = F.interpolate(encoded, (visual.side, visual.side), mode="bicubic", align_corners=True)
    mean, deviation = torch.tensor([0.48145466, 0.4578275, 0.40821073]), torch.tensor([0.26862954, 0.26130258, 0.27577711])
    token = visual((seen - mean[:, None, None]) / deviation[:, None, None])[:, None]
    x = torch.randn(latents.shape[1:], generator=generator)[None]
    for t in schedule.timesteps:
        eps = model.model.diffusion_model(torch.cat([x, latents], 1), t[None], token)
        noise = torch.randn(latents.shape[1:], generator=generator)[None] if t != schedule.timesteps[-1] else None
        x = schedule.step(eps, t, x, eta=1.0, use_clipped_model_output=True, variance_noise=noise).prev_sample
    decoded = model.first_stage_model.decode(x / 0.18215)
    return (decoded[0].movedim(0, -1) / 2 + 0.5).clamp(0, 1) ** 2.2


def test_samples_are_the_originals(weights: Path) -> None:
    shown = photographs()
    images, masks = shown.images, shown.masks
    drawn = IntrinsicAnythingPrior(weights=str(weights), steps=4).sample(shown, seed=5)
    samples = drawn.values
    assert drawn.cost["network_calls"] == 2 * 2 * 4  # components, images, steps
    for number, component in enumerate(COMPONENTS):
        model = LatentDiffusion.tiny({"albedo": 1, "specular": 2}[component]).reference()
        for view in range(2):
            seed = derive_seed(5, number, content_number(images[view], masks[view]))
            expected = original_sample(model, images[view], seed, 4)
            torch.testing.assert_close(samples[component][view], expected, atol=2e-4, rtol=0)
    assert float((samples["albedo"][0] - samples["albedo"][1]).abs().mean()) > 0.05


def test_conformance(weights: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = {"weights": weights, "components": "[albedo]", "steps": 2}  # the other component takes the same path
    assert check(["prior=intrinsicanything", *(f"prior.options.{key}={value}" for key, value in options.items())]) == 0
    assert " passed, 0 failed, 0 skipped" in capsys.readouterr().out


def test_guidance_draws_nearer_the_stronger_it_is_and_stays_in_range(weights: Path) -> None:
    shown = photographs(1)
    target = {"albedo": 0.3 * shown.images + 0.2}
    distances = []
    for strength in (0.0, 3.0, 30.0, 1000.0):
        prior = IntrinsicAnythingPrior(weights=str(weights), components=["albedo"], steps=5, guidance_strength=strength)
        drawn = prior.sample(shown, seed=0, guidance=target)
        sample = drawn.values["albedo"]
        assert bool(((sample >= 0) & (sample <= 1)).all())
        distances.append(float((sample - target["albedo"]).abs().mean()))
        assert drawn.cost["guided_estimates"] == (5 if strength else 0)
    assert distances == sorted(distances, reverse=True)
    assert distances[-1] < 0.9 * distances[0]


def test_provides_what_was_converted(weights: Path, tmp_path: Path) -> None:
    shutil.copytree(weights / "albedo", tmp_path / "albedo")
    assert IntrinsicAnythingPrior(weights=str(weights)).info.provides == {"albedo", "specular"}
    assert IntrinsicAnythingPrior(weights=str(weights), components=["specular"]).info.provides == {"specular"}
    prior = IntrinsicAnythingPrior(weights=str(tmp_path))
    assert prior.info.provides == {"albedo"}
    assert prior.info.resolution == 32
    with pytest.raises(InputError, match=r"weights=.*: expected albedo and specular/source.json .*, found albedo$"):
        IntrinsicAnythingPrior(weights=str(tmp_path), components=["albedo", "specular"])


def test_fingerprint_follows_what_decides_samples(weights: Path, tmp_path: Path) -> None:
    def fingerprint(**options: object) -> str:
        return IntrinsicAnythingPrior(**{"weights": str(weights), **options}).fingerprint

    shutil.copytree(weights, tmp_path / "copy")
    assert fingerprint() == fingerprint(weights=str(tmp_path / "copy"), batch=2)
    record = tmp_path / "copy" / "albedo" / "source.json"
    record.write_text(json.dumps({**json.loads(record.read_text()), "sha256": "0" * 64}))
    others = [{"steps": 3}, {"eta": 0.5}, {"guidance_strength": 1.0}, {"components": ["albedo"]}, {"weights": tmp_path / "copy"}]
    assert len({fingerprint(), *(fingerprint(**other) for other in others)}) == 1 + len(others)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"weights": None}, "prior.options.weights=None: expected albedo or specular/source.json as"),
        ({"weights": "/nowhere"}, "prior.options.weights=/nowhere: expected albedo or specular/source.json as"),
        ({"components": ["normals"]}, "expected normals/source.json as .*, found albedo, specular"),
        ({"steps": 0}, "prior.options.steps: expected 1 or more, found 0"),
        ({"device": "tpu"}, "unknown value of prior.options.device: 'tpu'.* There are: auto, cpu, cuda"),
    ],
)
def test_wrong_options(options: dict, message: str, weights: Path) -> None:
    with pytest.raises(InputError, match=message):
        create("prior", "intrinsicanything", built_in("prior")["intrinsicanything"].target, {"weights": str(weights), **options})


def without_a_tensor(folder: Path) -> None:
    from safetensors.torch import load_file, save_file

    path = folder / "unet" / "diffusion_pytorch_model.safetensors"
    tensors = load_file(path)
    del tensors["conv_out.bias"]
    save_file(tensors, path, metadata={"format": "pt"})


def cut_off(folder: Path) -> None:
    path = folder / "vae" / "diffusion_pytorch_model.safetensors"
    path.write_bytes(path.read_bytes()[:-100])


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (without_a_tensor, r"unet: expected tensors for every parameter, found none for conv_out.bias"),
        (cut_off, r"vae: expected converted weights, found: .*"),
        (lambda folder: shutil.rmtree(folder / "image_encoder"), r"image_encoder: expected converted weights, found: .*"),
        (lambda folder: (folder / "scheduler" / "scheduler_config.json").unlink(), r"scheduler_config.json: "),
        (lambda folder: (folder / "vae" / "config.json").write_text("{}"), r"config.json: expected JSON with the key sample_size"),
        (lambda folder: (folder / "source.json").write_text("not JSON"), r"source.json: not valid JSON"),
    ],
)
def test_damaged_weights(damage: Callable[[Path], object], message: str, weights: Path, tmp_path: Path) -> None:
    shutil.copytree(weights / "albedo", tmp_path / "albedo")
    damage(tmp_path / "albedo")
    with pytest.raises(InputError, match=message):
        IntrinsicAnythingPrior(weights=str(tmp_path)).sample(photographs(1), seed=0)


SIDE = 64


def disc(height: int, width: int, row: float, column: float, radii: tuple[float, float]) -> Tensor:
    """Coverage of an ellipse with an antialiased edge of about one pixel."""
    rows, columns = np.mgrid[:height, :width]
    distance = np.hypot((rows - row) / radii[0], (columns - column) / radii[1])
    return torch.from_numpy(np.clip((1 - distance) * min(radii) + 0.5, 0, 1).astype(np.float32))


def smooth_image(mask: Tensor) -> Tensor:
    """A premultiplied picture whose colours change slowly, within [0.2, 0.8]."""
    height, width = mask.shape
    rows, columns = torch.meshgrid(torch.arange(height) / height, torch.arange(width) / width, indexing="ij")
    colour = torch.stack([0.5 + 0.3 * torch.sin(3 * rows), 0.5 + 0.3 * torch.cos(2 * columns), 0.3 + 0.4 * rows * columns], -1)
    return colour * mask[..., None]


def test_crop_fills_the_longer_side_and_centres_the_shorter() -> None:
    mask = torch.zeros(20, 40)
    mask[3:9, 10:34] = 1  # 6 x 24
    mask[0, 0] = 0.5  # not more than half covered
    crop = Crop.of(mask, 48)
    assert crop == Crop(slice(3, 9), slice(10, 34), slice(18, 30), slice(0, 48))
    thin = torch.zeros(200, 3)
    thin[:, 1] = 1
    assert Crop.of(thin, 48) == Crop(slice(0, 200), slice(1, 2), slice(0, 48), slice(24, 25))  # round(23.5) = 24
    assert Crop.of(torch.full((4, 4), 0.5), 48) is None


def test_encoding_is_gamma_on_white() -> None:
    """At the networks' own size nothing is resampled, so every pixel follows from the definition."""
    mask = torch.ones(SIDE, SIDE)
    mask[10, 20], mask[11, 20], mask[12, 20] = 0.0, 0.4, 0.75
    colour = torch.rand(SIDE, SIDE, 3, generator=torch.Generator().manual_seed(0)) * 1.5  # up to 1.5: clipped
    image = colour * mask[..., None]
    square = encode(image, mask, Crop.of(mask, SIDE), SIDE)
    expected = colour.double().clamp(0, 1) ** (1 / 2.2)
    expected[10:12, 20] = 1  # half or less covered: white
    np.testing.assert_allclose(square.movedim(0, -1), expected, atol=1e-6)


@pytest.mark.parametrize("size", [(37, 31), (96, 64), (300, 411)])
def test_round_trip_keeps_a_smooth_object(size: tuple[int, int]) -> None:
    """Away from the silhouette, where white bleeds in, resampling a slow picture loses less than half a percent."""
    height, width = size
    mask = disc(height, width, 0.5 * height, 0.45 * width, (0.35 * height, 0.3 * width))
    image, crop = smooth_image(mask), Crop.of(mask, SIDE)
    back = decode(encode(image, mask, crop, SIDE), mask, crop)
    assert back.dtype == torch.float32
    assert bool((back[mask == 0] == 0).all())
    assert bool((back <= mask[..., None]).all())
    inner = disc(height, width, 0.5 * height, 0.45 * width, (0.27 * height, 0.22 * width)) == 1
    assert float((back - image)[inner].abs().max()) < 5e-3


def test_round_trip_at_the_own_size_is_exact_up_to_the_edge() -> None:
    mask = disc(SIDE, SIDE, 31.5, 31.5, (32.5, 32.5))
    image, crop = smooth_image(mask), Crop.of(mask, SIDE)
    back = decode(encode(image, mask, crop, SIDE), mask, crop)
    covered = mask > 0.5
    np.testing.assert_allclose(back[covered], image[covered], atol=1e-6)
    edge = (mask > 0) & ~covered
    assert bool(edge.any())
    neighbour = (back / mask[..., None])[edge]  # a colour of the object, not the white that the network saw there
    assert float(neighbour.max()) < 0.85


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
