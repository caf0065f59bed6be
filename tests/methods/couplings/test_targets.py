"""What reaches the losses of targets and distilled estimates: the right pixels, aligned when due, in the prior's encoding."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from small_fit import altered
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.methods.contract import Coupling, PixelSamples, Problem, StepRender
from ia_bench.methods.couplings.base import encode, shown
from ia_bench.methods.couplings.kernel import Kernel
from ia_bench.methods.couplings.targets import ALIGNMENT_PERIOD, Distilled, Statistics, Targets, ViewAlignment, align
from ia_bench.priors.contract import PriorInfo
from ia_bench.runs.composition import compose
from ia_bench.scenes.color import linear_to_srgb

VIEWS = 4
BOTH = frozenset({"albedo", "specular"})


class Encoded:
    """All that a coupling reads of a prior."""

    def __init__(self, albedo: str = "srgb") -> None:
        self.info = PriorInfo(BOTH, encoding={"albedo": albedo, "specular": "srgb"})


def even(**values: Tensor) -> PixelSamples:
    """Samples of equal weight everywhere."""
    return PixelSamples(values, torch.ones(len(next(iter(values.values()))), 1))


def prepared(coupling: Coupling, problem: Problem, samples: PixelSamples, texture: Tensor | None = None) -> Coupling:
    coupling.prepare(samples, altered(problem, prior=Encoded()) if "prior" not in vars(problem) else problem)
    if texture is not None:
        coupling.update(texture, 0)
    return coupling


def losses(coupling: Coupling, shown: Tensor, pixels: Tensor, texture: Tensor | None = None) -> dict[str, float]:
    """Of renders whose albedo and specular shading are both ``shown`` (B, 3)."""
    texture = torch.zeros(4, 4, 3) if texture is None else texture
    found = coupling.loss(StepRender(shown, shown, texture, torch.Generator().manual_seed(0)), pixels)
    return {name: float(value) for name, value in found.items()}


def test_alignment_is_found_from_the_texture(problem: Problem, texture: Tensor, seen: Tensor) -> None:
    """The estimate must see the same pixels as the renderer: half the albedo as target gives the scale 1/2 exactly."""
    every = torch.arange(len(seen))
    for mode in ("scale", "scale_shift"):
        targets = prepared(Targets(ssi=mode), problem, even(albedo=0.5 * seen), texture)  # type: ignore[arg-type]
        state = targets.state()
        torch.testing.assert_close(state["scale"], torch.full((16,), 0.5), rtol=1e-4, atol=0)
        torch.testing.assert_close(state["shift"], torch.zeros(16), rtol=0, atol=1e-5)
        assert losses(targets, seen, every)["albedo"] < 1e-4
        assert losses(targets, seen * torch.tensor([1.2, 1.0, 0.8]), every)["albedo"] > 0.01


@pytest.mark.parametrize("encoding", ["linear", "srgb"])
def test_loss_is_the_weighted_mean_in_the_priors_encoding(problem: Problem, texture: Tensor, seen: Tensor, encoding: str) -> None:
    chosen = torch.tensor([3, 50, 700])
    target, weight = seen.flip(0), torch.rand(len(seen), 1, generator=torch.Generator().manual_seed(1))
    told = altered(problem, prior=Encoded(encoding))
    targets = prepared(Targets(ssi="none"), told, PixelSamples({"albedo": target}, weight), texture)
    encode = linear_to_srgb if encoding == "srgb" else np.asarray
    differences = np.abs(encode(seen[chosen].double().numpy()) - encode(target[chosen].double().numpy()))
    expected = (weight[chosen].double().numpy() * differences).mean()
    assert losses(targets, seen[chosen], chosen)["albedo"] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("kind", [Targets, Kernel, Distilled])
def test_one_weight_a_component(problem: Problem, texture: Tensor, seen: Tensor, kind: type) -> None:
    """A loss is in proportion to it; one without is not there, and not asked for."""
    samples, every = even(albedo=seen.flip(0), specular=seen.flip(0)), torch.arange(len(seen))

    def found(**weights: float) -> dict[str, float]:
        return losses(prepared(kind(**weights), problem, samples, texture), seen, every, texture)

    one, other = found(albedo=1.0, specular=1.0), found(albedo=0.5, specular=0.1)
    assert min(one.values()) > 0
    assert other == pytest.approx({"albedo": 0.5 * one["albedo"], "specular": 0.1 * one["specular"]}, rel=1e-5)
    assert set(found(albedo=0.0, specular=1.0)) == {"specular"}
    assert kind(albedo=0.0, specular=1.0).uses(BOTH) == {"specular"}


def test_distilled_loss_is_half_the_square_in_any_unit_and_unaligned(problem: Problem, texture: Tensor, seen: Tensor) -> None:
    distilled = prepared(Distilled(), problem, even(albedo=0.5 * seen, specular=0.25 * seen), texture)
    assert distilled.state() == {}
    exact, found = seen.double().numpy(), losses(distilled, seen, torch.arange(len(seen)))
    for name, factor in (("albedo", 0.5), ("specular", 0.25)):
        expected = 0.5 * ((linear_to_srgb(exact) - linear_to_srgb(factor * exact)) ** 2).mean()
        assert found[name] == pytest.approx(expected, rel=1e-4)
    found = {}
    for unit in (1.0, 1e-3):
        other = altered(problem, prior=Encoded(), photographs=replace(problem.photographs, unit=unit))
        distilled = prepared(Distilled(albedo=0.0), other, even(specular=0.25 * seen / unit))
        found[unit] = losses(distilled, seen / unit, torch.arange(len(seen)))["specular"]
    assert found[1e-3] == pytest.approx(found[1.0], rel=1e-4)


def test_alignment_is_estimated_when_due(problem: Problem, texture: Tensor, seen: Tensor) -> None:
    samples = even(albedo=seen)
    targets, scales = prepared(Targets(), problem, samples), []
    for step in range(2 * ALIGNMENT_PERIOD + 1):
        targets.update(texture * (1 - 0.01 * step), step)
        scales.append(float(targets.state()["scale"][0]))
    changes = [step for step in range(1, len(scales)) if scales[step] != scales[step - 1]]
    assert changes == [ALIGNMENT_PERIOD, 2 * ALIGNMENT_PERIOD]
    resumed = prepared(Targets(), problem, samples)
    resumed.restore(targets.state())
    resumed.update(texture, 2 * ALIGNMENT_PERIOD + 1)  # not due, so the restored one stays
    assert float(resumed.state()["scale"][0]) == scales[-1]


def test_views_that_were_not_asked_have_no_say(problem: Problem, texture: Tensor, seen: Tensor) -> None:
    asked = problem.gbuffer.pixel < 4 * problem.gbuffer.shape[1] * problem.gbuffer.shape[2]
    samples = PixelSamples({"albedo": torch.where(asked[:, None], 0.5 * seen, 0.0)}, asked.float()[:, None] / asked.float().mean())
    others = torch.nonzero(~asked)[:, 0]
    for kind in (Targets, Kernel):
        assert losses(prepared(kind(), problem, samples, texture), seen[others], others, texture)["albedo"] == 0
    assert losses(prepared(Targets(), problem, samples, texture), seen, torch.arange(len(seen)))["albedo"] < 1e-4


@pytest.mark.parametrize("kind", [Targets, Kernel, Distilled])
def test_a_target_at_its_ceiling_asks_only_for_at_least_as_much(problem: Problem, kind: type) -> None:
    every = torch.arange(len(problem.gbuffer.pixel))
    radiance, clipped = torch.full((len(every), 3), 0.5), every % 2 == 0
    targets = prepared(kind(specular=1.0), problem, replace(even(specular=radiance), at_least={"specular": clipped[:, None]}))

    def loss(factor: float, chosen: Tensor) -> float:
        return losses(targets, factor * radiance[chosen], every[chosen])["specular"]

    assert loss(2, clipped) == 0
    assert loss(2, ~clipped) > 0.01
    assert loss(0.5, clipped) == pytest.approx(loss(0.5, ~clipped), rel=1e-5)


def test_a_coupling_that_a_priors_own_would_hide_is_refused() -> None:
    for prior, plain in (("letter", "diffusion"), ("letter_corrected", "corrected")):
        wanted = f"expected targets, which prior={prior} brings, found kernel; use prior={plain} coupling=kernel"
        with pytest.raises(InputError, match=f"^coupling: {wanted}$"):
            compose(["device=cpu", f"prior={prior}", "coupling=kernel"])
    for given in (["prior=letter", "coupling='targets'"], ["prior=combined", "coupling=targets"]):
        assert compose(["device=cpu", *given]).coupling.name == "targets"


# ---- SSI -------------------------------------------------------------------------------------------------------------
def pixels(count: int = 500, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Random predictions and targets (P, 3) in views (P,); the views have different numbers of pixels."""
    generator = torch.Generator().manual_seed(seed)
    view = (VIEWS * torch.rand(count, generator=generator) ** 2).long()
    return torch.rand(count, 3, generator=generator), 2 * torch.rand(count, 3, generator=generator) ** 3, view


def reference(prediction: Tensor, target: Tensor, view: Tensor, mode: str) -> tuple[np.ndarray, np.ndarray]:
    """Scale and shift per view: means and mean absolute deviations over all values of a view, in float64."""
    scales, shifts = [], []
    for one in range(VIEWS):
        p, t = (x[view == one].double().numpy().ravel() for x in (prediction, target))
        if mode == "scale":
            scales.append(t.mean() / p.mean())
            shifts.append(0.0)
        else:
            scales.append(np.abs(t - t.mean()).mean() / np.abs(p - p.mean()).mean())
            shifts.append(t.mean() - scales[-1] * p.mean())
    return np.array(scales), np.array(shifts)


def aligned_by(prediction: Tensor, target: Tensor, view: Tensor, mode: str) -> ViewAlignment:
    return align(*(Statistics.of(values, view, VIEWS) for values in (prediction, target)), mode)


@pytest.mark.parametrize("factor", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("mode", ["scale_shift", "scale"])
def test_alignment_equals_the_reference(mode: str, factor: float) -> None:
    prediction, target, view = pixels()
    prediction = factor * prediction
    alignment = aligned_by(prediction, target, view, mode)
    scale, shift = reference(prediction, target, view, mode)
    np.testing.assert_allclose(alignment.scale, scale, rtol=1e-5)
    np.testing.assert_allclose(alignment.shift, shift, atol=1e-6)
    aligned = alignment(prediction, view, torch.ones(len(view), 1)).double().numpy()
    expected = prediction.double().numpy() * scale[view][:, None] + shift[view][:, None]
    np.testing.assert_allclose(aligned, expected, rtol=1e-5, atol=1e-6)
    for one in range(VIEWS):
        here = (view == one).numpy()
        assert aligned[here].mean() == pytest.approx(target[here].double().mean().item(), rel=1e-5)


@pytest.mark.parametrize("mode", ["scale_shift", "scale", "none"])
@pytest.mark.parametrize(("prediction", "target"), [(0.3, 0.6), (0.0, 0.6), (0.3, 0.0), (0.0, 0.0), (-0.3, 0.6)])
def test_constant_images_are_safe(mode: str, prediction: float, target: float) -> None:
    view = torch.tensor([0, 0, 0, 2, 2])  # views 1 and 3 have no pixels
    p, t = torch.full((5, 3), prediction), torch.full((5, 3), target)
    alignment = aligned_by(p, t, view, mode)
    assert bool(torch.isfinite(alignment.scale).all() & torch.isfinite(alignment.shift).all())
    assert alignment.scale[[1, 3]].tolist() == [1, 1]
    assert alignment.shift[[1, 3]].tolist() == [0, 0]
    assert mode != "scale" or prediction > 0 or alignment.scale[0] == 1
    if mode == "scale_shift":
        assert alignment.scale.tolist() == [1, 1, 1, 1]
        torch.testing.assert_close(alignment(p, view, torch.ones(5, 1)), t)


@pytest.mark.parametrize("mode", ["scale_shift", "scale", "none"])
def test_the_gradient_is_that_of_the_whole_loss(problem: Problem, texture: Tensor, seen: Tensor, mode: str) -> None:
    """Against autograd through statistics of all pixels; nothing pulls along what SSI leaves open, the scale (and the shift)."""
    every = torch.arange(len(seen))[problem.gbuffer.filled]
    told = 0.3 + 0.4 * torch.rand(len(seen), 3, generator=torch.Generator().manual_seed(2))
    targets = prepared(Targets(ssi=mode), problem, even(albedo=told), texture)  # type: ignore[arg-type]
    shown = seen[every].clone().requires_grad_()
    targets.loss(StepRender(shown, shown, texture, torch.Generator()), every)["albedo"].backward()
    exact, view = seen[every].double().requires_grad_(), problem.gbuffer.view(every)
    views = problem.gbuffer.shape[0]
    found, wanted = (Statistics.of(values, view, views) for values in (exact, told[every].double()))
    whole = align(found, wanted, mode)(exact, view, torch.ones(len(every), 1))
    (encode(whole, "srgb") - encode(told[every].double(), "srgb")).abs().mean().backward()
    assert exact.grad is not None
    assert shown.grad is not None
    np.testing.assert_allclose(shown.grad, exact.grad, rtol=0, atol=3e-3 * float(exact.grad.abs().max()))
    for one in range(views if mode != "none" else 0):
        here = view == one
        gradient, values = shown.grad[here].double(), exact.detach()[here]
        size = float((gradient.abs() * values).sum())
        assert abs(float((gradient * values).sum())) < 1e-3 * size
        if mode == "scale_shift":
            assert abs(float(gradient.sum())) < 1e-3 * float(gradient.abs().sum())


def test_single_texels_are_pulled_as_renders_are_and_nothing_else_is(problem: Problem, texture: Tensor, seen: Tensor) -> None:
    """The gradient goes into the texture that coarser scales and the scale ambiguity do not see, and is the same."""
    chosen = torch.arange(0, len(seen), 3)
    gradients: dict[bool, list[Tensor | None]] = {}
    for single in (False, True):
        targets = prepared(Targets(single_texels=single), problem, even(albedo=seen.flip(0)), texture)
        shared, alone = (texture.clone().requires_grad_(True) for _ in range(2))
        rendered = shown(shared, chosen, problem)
        torch.testing.assert_close(rendered.detach(), seen[chosen])
        render = StepRender(rendered, rendered, alone, torch.Generator())
        (loss,) = targets.loss(render, chosen).values()
        loss.backward()
        gradients[single] = [shared.grad, alone.grad]
    pulled = gradients[False][0]
    assert pulled is not None
    assert float(pulled.abs().max()) > 1e-5
    assert (gradients[False][1], gradients[True][0]) == (None, None)
    torch.testing.assert_close(gradients[True][1], pulled, rtol=1e-4, atol=1e-7)
