import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from priors.tiny_network import tiny_config, tiny_weights
from scipy.ndimage import gaussian_filter

from ia_bench.checks.conformance import check_prior
from ia_bench.checks.painted_ball import painted_ball, shown
from ia_bench.common.errors import InputError
from ia_bench.common.registry import built_in, create
from ia_bench.common.seeds import derive_seed
from ia_bench.priors.contract import Observations
from ia_bench.priors.diffusion import prior as diffusion_prior
from ia_bench.priors.diffusion import sampler
from ia_bench.priors.diffusion.encoding import MARGIN, Frame
from ia_bench.priors.diffusion.learned import RegressorPrior
from ia_bench.priors.diffusion.network import MaterialNetwork
from ia_bench.priors.diffusion.patches import patch_origins
from ia_bench.priors.diffusion.prior import DiffusionPrior
from ia_bench.priors.diffusion.sampler import seeded_noise
from ia_bench.priors.inputs import content_number, use_bf16
from ia_bench_training.saving import save_network


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return str(tiny_weights(tmp_path_factory.mktemp("diffusion") / "weights"))


@pytest.fixture(scope="module")
def regressor_weights(tmp_path_factory):
    return str(tiny_weights(tmp_path_factory.mktemp("regressor") / "weights", "regressor"))


@pytest.fixture(scope="module")
def ball():
    return shown(painted_ball(40, 36, 3))


def failures(make):
    return [finding for finding in check_prior(make, painted_ball(24, 20, 3)) if finding.status == "fail"]


PAPER = {"guidance_rule": "paper", "guidance_norm": "l2"}


@pytest.mark.parametrize("options", [{}, {"patches": True}, {"eta": 1.0, "batch": 1}, {**PAPER, "geometry": True}], ids=str)
def test_the_prior_keeps_its_contract(weights, options):
    assert not failures(lambda: DiffusionPrior(weights=weights, steps=3, **options))


def test_a_photograph_has_the_same_sample_beside_larger_ones_to_whose_size_it_is_padded(weights, ball):
    padded = ball.each(lambda values: torch.nn.functional.pad(values, (*(0, 0) * (values.ndim - 3), 0, 9, 0, 5)))
    height, width = ball.masks.shape[1:]
    prior = DiffusionPrior(weights=weights, steps=2)
    plain, beside = (prior.sample(each, seed=1).values["albedo"] for each in (ball, padded))
    torch.testing.assert_close(beside[:, :height, :width], plain, rtol=1e-4, atol=1e-5)


def test_haze_is_no_foreground(weights, ball):
    """Of a mask that a matting tool has made: coverage of 1 in 255 in a corner moves no frame."""
    hazy = ball.masks.clone()
    hazy[:, 0, 0] = 1 / 255
    assert [Frame.around(mask, 16) for mask in hazy] == [Frame.around(mask, 16) for mask in ball.masks]
    assert Frame.around(hazy[0] / 300, 16) == Frame.around(ball.masks[0], 16), "of faint glass all counts"


def test_the_regressor_keeps_its_contract(regressor_weights):
    assert not failures(lambda: RegressorPrior(weights=regressor_weights))


def test_two_networks_with_one_component_each_are_one_prior(tmp_path, ball):
    for name in ("albedo", "specular"):
        tiny_weights(tmp_path / name, components=(name,))
    both = DiffusionPrior(weights=str(tmp_path), steps=2)
    assert both.info.provides == {"albedo", "specular"}
    drawn = both.sample(ball, seed=0)
    alone = DiffusionPrior(weights=str(tmp_path / "specular"), steps=2)
    assert alone.info.provides == {"specular"}
    assert torch.equal(alone.sample(ball, seed=0).values["specular"], drawn.values["specular"])
    assert drawn.cost["network_calls"] == 2 * 2 * 3


ALBEDO, SPECULAR = {"components": ("albedo",)}, {"components": ("specular",)}


@pytest.mark.parametrize(
    ("folders", "message"),
    [
        ({"albedo": ALBEDO, "specular": {**SPECULAR, "size": 32}}, "one size .* found sizes .16, 32"),
        ({"albedo": ALBEDO, "specular": {}}, "without a component in common, found .* components albedo, albedo"),
        ({".": {"kind": "regressor"}}, "kind: expected diffusion, found regressor"),
        ({".": {"geometry": False}}, "geometry=true: .*: expected weights trained with geometry"),
    ],
)
def test_weights_that_make_no_prior_are_refused(tmp_path, folders, message):
    for name, changes in folders.items():
        tiny_weights(tmp_path / "weights" / name, **changes)
    with pytest.raises(InputError, match=message):
        DiffusionPrior(weights=str(tmp_path / "weights"), geometry=True)


def test_specular_follows_the_scale_of_the_image_and_albedo_does_not(weights, ball):
    prior = DiffusionPrior(weights=weights, steps=2)
    brighter = replace(ball, images=100 * ball.images)
    # The seed of a view's noise is the content of its image; the same noise shows what scaling alone does.
    prior_seed = "ia_bench.priors.diffusion.learned.content_number"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(prior_seed, lambda image, mask: 1)
        once, brighter = prior.sample(ball, seed=0).values, prior.sample(brighter, seed=0).values
    torch.testing.assert_close(brighter["albedo"], once["albedo"], atol=2e-4, rtol=0)
    torch.testing.assert_close(brighter["specular"], 100 * once["specular"], atol=0.05, rtol=1e-3)


def test_strong_guidance_arrives_at_the_render(weights, ball):
    images, masks = ball.images, ball.masks
    render = {"albedo": 0.35 * masks[..., None].expand_as(images), "specular": 0.1 * images}
    prior = DiffusionPrior(weights=weights, steps=5, guidance_strength=1000)
    drawn = prior.sample(ball, seed=0, guidance=render)
    inside = masks == 1
    assert (drawn.values["albedo"] - render["albedo"])[inside].abs().mean() < 0.02
    count = 5 * len(images)
    assert drawn.cost == {"network_calls": count, "guided_estimates": count, "guided_cut": 0}


def test_each_component_is_drawn_by_a_norm_of_its_own(weights, ball, monkeypatch):
    """A network whose values do not depend on each other: the albedo knows nothing of a specular render far off."""
    monkeypatch.setattr(MaterialNetwork, "denoise", lambda self, noisy, timestep, condition, tokens: 0.3 * noisy)
    prior = DiffusionPrior(weights=weights, steps=5, **PAPER)
    masks = ball.masks[..., None].expand_as(ball.images)
    render = {"albedo": 0.35 * masks, "specular": 100 * ball.images.amax() * masks}
    alone, both = (prior.sample(ball, seed=0, guidance=some) for some in ({"albedo": render["albedo"]}, render))
    assert alone.cost["guided_cut"] == both.cost["guided_cut"] == 0
    torch.testing.assert_close(both.values["albedo"], alone.values["albedo"], rtol=0, atol=1e-5)


def test_distillation_noises_renders_as_the_schedule_says_at_native_size(weights, ball, monkeypatch):
    """Mean and variance of the noise within 5 standard errors (false alarm 1e-6), levels over the whole of their range."""
    asked = []

    def denoise(self, noisy, timestep, condition, tokens):
        asked.append((noisy, int(timestep[0]), condition[:, 3:4]))
        return torch.zeros_like(noisy)

    monkeypatch.setattr(MaterialNetwork, "denoise", denoise)
    black = {name: torch.zeros_like(ball.images) for name in ("albedo", "specular")}
    prior = DiffusionPrior(weights=weights, patches=True)
    for seed in range(40):
        prior.distill(ball, black, seed=seed)
    assert {noisy.shape[1:] for noisy, *_ in asked} == {(6, 16, 16)}
    timesteps = [t for _, t, _ in asked]
    assert 20 <= min(timesteps) < 100
    assert 900 < max(timesteps) < 980
    levels = tiny_config().noise_schedule.alpha_bar
    noise = []
    for noisy, t, coverage in asked:
        clean = torch.where(coverage > 0, -1.0, 0.0)  # black, encoded
        noise.append((noisy - levels[t].sqrt() * clean) / (1 - levels[t]).sqrt())
    values = torch.cat(noise).flatten()
    assert abs(float(values.mean())) < 5 / len(values) ** 0.5
    assert abs(float(values.var()) - 1) < 5 * (2 / len(values)) ** 0.5


@pytest.mark.parametrize(("side", "patched"), [(46, False), (48, False), (50, True)])  # 16 pixels natively, so a reduction by 3
def test_only_what_would_be_reduced_too_far_is_cut_into_patches(weights, side, patched):
    """Each image by itself: whatever lies beside it, an object that is small enough is reduced as a whole."""
    masks = torch.zeros(2, 60, 60)
    length = round(side / (1 + 2 * MARGIN))
    masks[0, :length, :length], masks[1, :20, :20] = 1, 1
    shown = Observations(0.5 * masks[..., None].expand(2, 60, 60, 3), masks)
    drawn = DiffusionPrior(weights=weights, steps=1).sample(shown, seed=0)
    assert drawn.cost.get("patched_images", 0) == patched
    small = DiffusionPrior(weights=weights, steps=1, patches=False).sample(shown.select([1]), seed=0)
    torch.testing.assert_close(drawn.values["albedo"][1:], small.values["albedo"], atol=1e-5, rtol=0)


def test_geometry_reaches_the_network_only_if_asked(weights, ball):
    masks = ball.masks[..., None]
    normals = torch.nn.functional.normalize(torch.randn(*ball.images.shape, generator=torch.Generator().manual_seed(0)), dim=-1)
    samples = {}
    for geometry in (False, True):
        prior = DiffusionPrior(weights=weights, steps=1, geometry=geometry)
        assert prior.info.wants == ({"normals", "visibility"} if geometry else set())
        seen = replace(ball, normals=normals * masks, visibility=0.5 * masks)
        samples[geometry] = tuple(prior.sample(shown, seed=0).values["albedo"] for shown in (ball, seen))
    assert torch.equal(*samples[False])
    assert torch.equal(samples[False][0], samples[True][0])
    assert not torch.allclose(*samples[True], atol=1e-3)


def test_networks_of_one_component_each_draw_noise_of_their_own(tmp_path, weights, ball, monkeypatch):
    for name in ("albedo", "specular"):
        tiny_weights(tmp_path / name, components=(name,))
    used = []

    def noise_of(seeds, shape):
        used.append(list(seeds))
        return seeded_noise(seeds, shape)

    for module in (diffusion_prior, sampler):
        monkeypatch.setattr(module, "seeded_noise", noise_of)
    apart, jointly = DiffusionPrior(weights=str(tmp_path), steps=2), DiffusionPrior(weights=weights, steps=2)
    renders = {"albedo": ball.images, "specular": ball.images}
    for draw in (lambda prior: prior.sample(ball, seed=3), lambda prior: prior.distill(ball, renders, seed=3)):
        used.clear()
        draw(apart)
        albedo, specular = used
        assert len({*albedo, *specular}) == 2 * len(ball.images)
        used.clear()
        draw(jointly)
        contents = [content_number(*one) for one in zip(ball.images, ball.masks, strict=True)]
        assert used == [[derive_seed(3, content) for content in contents]]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"steps": 2000}, r"steps: expected at most 1000 \(the schedule's length\), found 2000"),
        ({"guidance_norm": "l2"}, 'prior.options.guidance_norm: expected "squared" with the rule "variance", found \'l2\''),
    ],
)
def test_options_are_checked_at_once(weights, options, message):
    with pytest.raises(InputError, match=message):
        create("prior", "diffusion", built_in("prior")["diffusion"].target, {"weights": weights, **options})


@pytest.mark.parametrize("prior", [DiffusionPrior, RegressorPrior])
def test_the_packaged_weights_know_shading_from_paint(ball, prior):
    """A grey ball lit from one side: the estimate of its albedo is evener than its image, in most of every view."""
    masks = ball.masks
    slope = torch.linspace(0.1, 1.0, masks.shape[2])[None, None, :, None].expand(*masks.shape, 1)
    lit = (0.5 * slope * masks[..., None]).expand(*masks.shape, 3).contiguous()
    known = prior()
    albedo = torch.stack([known.sample(Observations(lit, masks), seed=seed).values["albedo"] for seed in range(4)]).mean(0)
    inside = masks == 1

    def unevenness(values):
        return float(torch.log(values[inside].mean(-1).clamp_min(1e-3)).std())

    assert bool(torch.isfinite(albedo).all())
    assert unevenness(albedo) < 0.7 * unevenness(lit)


def test_no_sample_exceeds_the_ceiling_and_some_come_near_it(tmp_path, ball):
    """A network pushed to white everywhere gives exactly the ceiling, under the image's own exposure."""
    network = MaterialNetwork(tiny_config("regressor"))
    with torch.no_grad():
        for parameter in network.head.leave.parameters():
            parameter.zero_()
        network.head.leave.bias += 5.0
    save_network(tmp_path / "white", network, {"steps": 0})
    factors = torch.tensor([1.0, 10.0, 0.01])
    prior = RegressorPrior(weights=str(tmp_path / "white"))
    drawn = prior.sample(replace(ball, images=ball.images * factors[:, None, None, None]), seed=0)
    assert set(drawn.ceilings) == {"specular"}
    ceiling = drawn.ceilings["specular"]
    torch.testing.assert_close(drawn.values["specular"].amax((1, 2, 3)), ceiling, rtol=1e-4, atol=0)
    plain = prior.sample(ball, seed=0).ceilings["specular"]
    torch.testing.assert_close(ceiling, plain * factors, rtol=1e-3, atol=0)


DRAW = """
import sys
import numpy as np
from ia_bench.checks.painted_ball import painted_ball, shown
from ia_bench.priors.diffusion.prior import DiffusionPrior
drawn = DiffusionPrior(device="cpu").sample(shown(painted_ball(64, 64, 3)), seed=0)
np.savez(sys.argv[1], **{name: values.numpy() for name, values in drawn.values.items()})
"""


def drawn_by_a_processor_with(instructions: str, folder: Path) -> dict[str, np.ndarray]:
    environment = os.environ | {"ONEDNN_MAX_CPU_ISA": instructions}
    subprocess.run([sys.executable, "-c", DRAW, folder / f"{instructions}.npz"], check=True, env=environment)
    with np.load(folder / f"{instructions}.npz") as found:
        return dict(found)


@pytest.mark.parametrize(
    ("precision", "device", "expected"), [("auto", "cpu", False), ("bf16", "cpu", True), ("float32", "cuda", False)]
)
def test_processors_compute_in_float32_unless_they_are_told(precision: str, device: str, expected: bool) -> None:
    assert use_bf16(precision, torch.device(device)) is expected


@pytest.mark.slow
def test_samples_are_those_of_a_processor_with_other_instructions(tmp_path: Path) -> None:
    """To rounding: with products of bfloat16, where there are some, pixels would be .01 apart, and fits a tenth of a decibel."""
    found, others = (drawn_by_a_processor_with(name, tmp_path) for name in ("ALL", "AVX2"))
    assert found.keys() == others.keys() == {"albedo", "specular"}
    for name, values in found.items():
        np.testing.assert_allclose(values, others[name], atol=1e-5, rtol=0)


@pytest.mark.slow
def test_the_packaged_network_leaves_no_seams():
    """Within 5 % on a stationary texture; 24 images x 150 rows x 3 channels, 8 lines, so the ratio scatters by about 1 %.

    Compared with other lines of the same parity: the folding of pixels by the network itself may give odd and even lines
    gradients of different energy, with and without patches.
    """
    count, size, random = 24, 150, np.random.default_rng(1)
    texture, light = (gaussian_filter(random.standard_normal((count, size, size, c)), (0, w, w, 0)) for c, w in ((3, 2), (1, 6)))
    images = torch.from_numpy(0.3 * np.exp(0.4 * texture / texture.std() + 0.3 * light / light.std())).float()
    masks = torch.ones(count, size, size)
    albedo = DiffusionPrior(patches=True).sample(Observations(images, masks), seed=0).values["albedo"].sqrt()
    frame = Frame.around(masks[0], None)
    origins = {origin for origin, _ in patch_origins(frame.side, 64)}
    lines = {line + frame.left - 1 for origin in origins for line in (origin, origin + 64)}  # their last pixel before the border
    lines = [line for line in sorted(lines) if 8 < line < size - 8]
    energy = sum((axis[:, 1:] - axis[:, :-1]).square().mean((0, 2, 3)) for axis in (albedo, albedo.transpose(1, 2)))
    alike = [line for line in range(9, size - 9) if line % 2 == lines[0] % 2 and line not in lines]
    assert len(lines) == 4
    assert float(energy[lines].mean() / energy[alike].mean()) == pytest.approx(1, abs=0.05)
