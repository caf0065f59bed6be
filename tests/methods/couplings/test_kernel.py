"""The similarity kernel: which pairs count and how much, against a loop; and what it must not see: the scale of a view."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from small_fit import altered
from torch import Tensor

from ia_bench.material.textures import fetch
from ia_bench.methods.contract import PixelSamples, Problem, StepRender
from ia_bench.methods.couplings.kernel import LOG_FLOOR, PAIRS, Kernel
from ia_bench.scenes.color import linear_to_srgb

SIZE = 32 * 32


def kernel(problem: Problem, prediction: Tensor, weight: Tensor | None = None, **options: float) -> Kernel:
    found = Kernel(albedo=1.0, **options)
    found.prepare(PixelSamples({"albedo": prediction}, torch.ones(len(prediction), 1) if weight is None else weight), problem)
    return found


def loss_of(one: Kernel, pixels: Tensor, texture: Tensor, seed: int = 0) -> Tensor:
    nothing = torch.zeros(len(pixels), 3)
    return one.loss(StepRender(nothing, nothing, texture, torch.Generator().manual_seed(seed)), pixels)["albedo"]


def loss(one: Kernel, pixels: Tensor, texture: Tensor, seed: int = 0) -> float:
    return float(loss_of(one, pixels, texture, seed))


def test_loss_is_that_of_a_loop(problem: Problem, seen: Tensor, texture: Tensor) -> None:
    """The formula in float64 over the very pairs that were drawn, of pixels that the object fills; the others draw none."""
    prediction = seen.flip(0)
    weight = torch.rand(len(seen), 1, generator=torch.Generator().manual_seed(3))
    one = kernel(problem, prediction, weight, free_scale=False, scale=0.4)
    asked, full = torch.arange(0, len(seen), 5), (problem.gbuffer.filled & (problem.photographs.mask[:, 0] > 0.999)).numpy()
    pixels = asked[full[asked]]
    assert 0 < len(pixels) < len(asked)
    partner, uv, found = one._partners(pixels, torch.Generator().manual_seed(0))
    there = fetch(texture, uv).double().numpy()
    colour, albedo = linear_to_srgb(prediction.double().numpy()), seen.double().numpy()
    total, weights, valid = 0.0, 0.0, 0
    for number in range(len(pixels) * PAIRS):
        i, j = int(pixels[number // PAIRS]), int(partner[number])
        if not (found[number] and full[i] and full[j]):
            continue
        valid += 1
        similarity = np.exp(-((colour[i] - colour[j]) ** 2).sum() / (2 * 0.4**2))
        change = np.abs(np.log(albedo[i] + LOG_FLOOR) - np.log(there[number] + LOG_FLOOR)).mean()
        confidence = float(weight[i] * weight[j]) ** 0.5
        total += confidence * similarity * change
        weights += confidence
    assert valid > len(pixels) / 4
    assert loss(one, asked, texture) == pytest.approx(total / weights, rel=1e-4)


def test_pairs_lie_in_one_view_within_the_radius(problem: Problem, seen: Tensor) -> None:
    pixels = torch.arange(len(seen)).repeat(4)
    for radius in (0.1, 0.4):
        partner, uv, found = kernel(problem, seen, radius=radius)._partners(pixels, torch.Generator().manual_seed(0))
        here = problem.gbuffer.pixel[pixels.repeat_interleave(PAIRS)]
        there = problem.gbuffer.pixel[partner]
        found = found > 0
        own = problem.renderer.surface.uv(problem.gbuffer.face[partner].clamp_min(0).long(), problem.gbuffer.barycentric[partner])
        assert float((own - uv[:, None]).abs().sum(-1).amin(1).max()) == 0  # a point of the partner, and not always the same
        assert len({int(n) for n in (own - uv[:, None]).abs().sum(-1).argmin(1)}) == problem.gbuffer.subsamples
        assert bool((here // SIZE == there // SIZE).all())
        assert bool((there == here)[~found].all())
        across = (here % 32 - there % 32)[found].double()
        down = (here // 32 % 32 - there // 32 % 32)[found].double()
        distance = (across**2 + down**2).sqrt()
        assert float(distance.min()) >= 1
        assert float(distance.max()) <= radius * 32 + 1  # rounded to pixels
        assert float(distance.max()) > 0.8 * radius * 32
        assert float(found.float().mean()) > 0.5
    other, *_ = kernel(problem, seen)._partners(pixels, torch.Generator().manual_seed(1))
    assert not torch.equal(other, partner)


def test_scale_of_a_view_changes_nothing(problem: Problem, seen: Tensor, texture: Tensor) -> None:
    scale = torch.exp(0.4 * torch.randn(16, generator=torch.Generator().manual_seed(2)))
    spoiled = seen * scale[problem.gbuffer.pixel // SIZE][:, None]
    pixels = torch.arange(len(seen))
    exact, other = (loss(kernel(problem, one), pixels, texture) for one in (seen, spoiled))
    assert other == pytest.approx(exact, rel=1e-5)
    trusted = loss(kernel(problem, spoiled, free_scale=False), pixels, texture)
    assert trusted != pytest.approx(exact, rel=1e-2)
    tinted = loss(kernel(problem, 0.5 * seen), pixels, 0.3 * texture)
    assert tinted == pytest.approx(exact, rel=0.1)  # nor does the scale of the fit, up to the floor of the log


def test_edge_pixels_and_masked_ones_are_no_partners(problem: Problem, seen: Tensor, texture: Tensor) -> None:
    full = (problem.gbuffer.face >= 0).all(1)
    edge = torch.nonzero(~full)[:, 0]
    assert len(edge) > 50
    assert loss(kernel(problem, seen), edge, texture) == 0
    unmasked = tuple(replace(view, mask=np.zeros_like(view.mask)) for view in problem.scene.train)
    blind = altered(problem, scene=replace(problem.scene, train=unmasked))
    assert loss(kernel(blind, seen), torch.arange(len(seen)), texture) == 0


def test_gradient_reaches_both_pixels(problem: Problem, seen: Tensor, texture: Tensor) -> None:
    one = kernel(problem, torch.full_like(seen, 0.4))
    pixels = torch.arange(0, len(seen), 7)
    atlas = texture.clone().requires_grad_(True)
    loss_of(one, pixels, atlas).backward()
    assert bool(torch.isfinite(atlas.grad).all())
    for entries in (pixels, one._partners(pixels, torch.Generator().manual_seed(0))[0]):
        point = problem.gbuffer.face[entries, :1].clamp_min(0).long()
        uv = problem.renderer.surface.uv(point, problem.gbuffer.barycentric[entries, :1])
        assert float((fetch(atlas.grad.abs(), uv[:, 0]).sum(-1) > 0).float().mean()) > 0.3
    scale = (atlas.grad * (texture + LOG_FLOOR)).sum() / (atlas.grad * (texture + LOG_FLOOR)).abs().sum()
    assert abs(float(scale)) < 0.02, "it says nothing of the albedo's scale"
