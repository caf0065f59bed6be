"""The kernels of the estimator against the same in torch (benchmarks/reference.py) in float64, with the same draws.

Points of all kinds are made up: seen from the normal to grazing, from in front and from behind, some of them misses, over
textures of different sizes with roughness at both of its ends. Values and gradients are compared at the float32 directions
that the kernels drew, because a narrow lobe changes by more than the tolerance from one float32 direction to the next.
"""

from __future__ import annotations

from dataclasses import dataclass

import kernel_calls
import pytest
import torch
from torch import Tensor

from benchmarks import reference
from benchmarks.reference import specular_lobes
from ia_bench.light.latlong import SampledLight, direction_to_texel
from ia_bench.material.brdf import MIN_ROUGHNESS, dot, tangent_frame, visible_ggx_pdf
from ia_bench.material.textures import Material
from ia_bench.render.estimator import DirectionSamples, FromObject, draw_samples, shade_samples
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.render.lattice import lattice

pytestmark = pytest.mark.verify

PIXELS, POINTS, COUNT = 400, 4, 3
CLOSE = 1e-4  # of the largest value, or gradient, of its kind
LIGHTS = ("random", "sun", "black")


def uniform(*shape: int, seed: int) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def light_of(name: str) -> SampledLight:
    radiance = {"random": uniform(9, 14, 3, seed=1) ** 4, "sun": torch.full((16, 32, 3), 0.1), "black": torch.zeros(4, 8, 3)}[name]
    if name == "sun":
        radiance[4, 20] = 1e6
    return SampledLight.of(radiance, uniform_fraction=0.2)


def made_up_points() -> tuple[SurfacePoints, Tensor]:
    """N points and which of them are hits; cosines of the views from 1 down to 1e-6."""
    count = PIXELS * POINTS
    rng = torch.Generator().manual_seed(2)
    normal = torch.nn.functional.normalize(torch.randn(count, 3, generator=rng), dim=-1)
    normal[:6] = torch.cat([torch.eye(3), -torch.eye(3)])
    cosine = torch.rand(count, 1, generator=rng)
    cosine[::10] = 10 ** (-6 * torch.rand(len(cosine[::10]), 1, generator=rng))
    tangent, bitangent = tangent_frame(normal)
    angle = 2 * torch.pi * torch.rand(count, 1, generator=rng)
    view = (1 - cosine**2).sqrt() * (angle.cos() * tangent + angle.sin() * bitangent) + cosine * normal
    uv = 1.1 * torch.rand(count, 2, generator=rng) - 0.05
    view = torch.nn.functional.normalize(view, dim=-1)
    front = torch.rand(count, 1, generator=rng) < 0.7
    surface = SurfacePoints(torch.randn(count, 3, generator=rng), normal, view, uv, normal, front)
    return surface, torch.rand(count, generator=rng) < 0.9


def made_up_material(*, metallic: bool, coat: str = "added") -> Material:
    roughness = uniform(5, 5, 1, seed=3).clamp_min(MIN_ROUGHNESS)
    roughness[:2, :2] = MIN_ROUGHNESS  # all four texels of some look-ups
    roughness[3:, 3:] = 1.0 if coat == "added" else 0.98  # the coat's table ends at 1, where its slope is either side's
    return Material(uniform(7, 7, 3, seed=4), roughness, uniform(3, 3, 1, seed=5) if metallic else None)


def made_up_object(drawn: DirectionSamples) -> FromObject:
    """An atlas of 11 texels; every third direction by the BRDF that is above the surface ends on one of them."""
    arriving, leaving = uniform(11, 3, seed=6), 5 * uniform(11, 3, seed=7)
    atlas = torch.randint(11, (6, 6), dtype=torch.int32, generator=torch.Generator().manual_seed(8))
    seen = torch.randint(11, drawn.boost.shape, dtype=torch.int32, generator=torch.Generator().manual_seed(9))
    above = drawn.texel[:, drawn.boost.shape[1] :] >= 0
    return FromObject(arriving, leaving, atlas, torch.where(above & (seen % 3 == 0), seen, -1))


def draw(
    light: SampledLight, roughness: Tensor, part: int = 0, parts: int = 1
) -> tuple[SurfacePoints, Tensor, Tensor, DirectionSamples]:
    """Points, which are hits, rotations and samples."""
    surface, hit = made_up_points()
    rotation = torch.rand(2, PIXELS, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(10))
    drawn = draw_samples(surface, hit, roughness, light.sampler, rotation, points=POINTS, count=COUNT, part=part, parts=parts)
    return surface, hit, rotation, drawn


def exact(surface: SurfacePoints) -> SurfacePoints:
    """In float64, but the flags."""
    parts = (getattr(surface, name).double() for name in ("position", "normal", "view", "uv", "geometric"))
    return SurfacePoints(*parts, surface.front)


def assert_near(found: Tensor, wanted: Tensor, close: float = CLOSE) -> None:
    assert torch.isfinite(found).all()
    torch.testing.assert_close(found.double(), wanted.double(), rtol=0, atol=close * max(float(wanted.abs().max()), 1e-30))


# ---------------------------------------------------------------- drawing
@pytest.mark.parametrize(("part", "parts"), [(0, 1), (0, 3), (2, 3)])
@pytest.mark.parametrize("name", LIGHTS)
def test_directions_and_texels(name: str, part: int, parts: int) -> None:
    """The lattice, the table and the lobe give the directions of torch; texels differ at their borders alone."""
    light, material = light_of(name), made_up_material(metallic=False)
    surface, hit, rotation, drawn = draw(light, material.roughness, part, parts)
    lattices = [lattice(start, POINTS, COUNT, part, parts).reshape(-1, COUNT, 3) for start in rotation]
    points = exact(surface)
    roughness = reference.fetch(material.roughness.double(), points.uv)
    direction, texel = reference.draw_directions(points.normal, points.view, roughness, *lattices, light.sampler)
    above = (points.normal[:, None] * direction).sum(-1)
    assert (drawn.texel[~hit] == -1).all()
    clear = hit[:, None] & (above.abs() > 1e-5)
    assert torch.equal(drawn.texel[clear] >= 0, above[clear] > 0)
    sine = direction[..., :2].norm(dim=-1).clamp_min(1e-3)  # near a pole float32 knows a direction less well
    error = (drawn.direction.double() - direction).norm(dim=-1) * sine
    assert float(error[hit][:, :COUNT].max()) < 1e-6
    assert float(error[hit][:, COUNT:].max()) < 2e-5
    valid = drawn.texel >= 0
    assert torch.equal(drawn.texel[:, :COUNT][valid[:, :COUNT]], texel[:, :COUNT][valid[:, :COUNT]].int())
    assert float((drawn.texel != texel)[valid].float().mean()) < 1e-3


@pytest.mark.parametrize("name", LIGHTS)
def test_terms_and_boosts(name: str) -> None:
    """Cosine, lobe and slope times the weight, the grazing part, and the weight alone over that, at the directions drawn.

    Relative to themselves, but the slope, which crosses zero.
    """
    light, material = light_of(name), made_up_material(metallic=False)
    surface, _, _, drawn = draw(light, material.roughness)
    points, direction = exact(surface), drawn.direction.double()
    texel, valid = drawn.texel.clamp_min(0).long(), drawn.texel >= 0
    roughness = reference.fetch(material.roughness.double(), points.uv)
    n, o, rough = points.normal[:, None], points.view[:, None], roughness[:, None].expand(*texel.shape, 1).clone().requires_grad_()
    direction = torch.where(valid[..., None], direction, n)  # what was not drawn is no number
    cell = reference.normal_bin(surface.normal)[:, None]
    pdf = visible_ggx_pdf(n, o, direction, rough.detach())
    weight = 1 / (COUNT * (reference.density(light.sampler, cell, texel, torch.float64)[..., None] + pdf).clamp_min(1e-12))
    base, grazing = specular_lobes(n, o, direction, rough)
    value, alpha = base + grazing, (rough * rough).detach()
    (slope,) = torch.autograd.grad(value.sum(), rough)
    slope = torch.where(rough > 0, slope / (2 * rough), 0.0)  # by alpha
    wanted = torch.cat([dot(n, direction) * weight, value * weight, slope * weight], -1).detach()
    narrow = (alpha < 1e-3).expand_as(valid[..., None])[..., 0]
    cosine = dot(n, direction)[..., 0]
    for which, close in ((valid & ~narrow & (cosine > 1e-3), 2e-4), (valid & (cosine > 1e-3), 2e-2)):
        found = drawn.terms[which].double()
        torch.testing.assert_close(found[:, :2], wanted[which][:, :2], rtol=close, atol=1e-30)
        scale = (wanted[..., 1:2] / alpha.clamp_min(1e-30))[which][:, 0].abs()
        some = scale < 1e20  # alpha = 0 has no slope to speak of
        assert float(((found[:, 2] - wanted[which][:, 2]).abs() / scale.clamp_min(1e-30))[some].max()) < 10 * close
    shown = (base + grazing)[..., 0].detach() > 0
    share = (grazing / (base + grazing).clamp_min(1e-30))[..., 0].detach()
    torch.testing.assert_close(drawn.terms[..., 3][valid & shown].double(), share[valid & shown], rtol=0, atol=1e-5)
    alone = (1 / (COUNT * weight * pdf.clamp_min(1e-12)))[:, COUNT:, 0]
    counts = (valid & (cosine > 1e-3) & ~narrow)[:, COUNT:]
    torch.testing.assert_close(drawn.boost[counts].double(), alone[counts], rtol=2e-4, atol=0)


def test_a_mirror_has_neither_value_nor_slope() -> None:
    """Roughness 0, which no fit has, and no NaN."""
    light, roughness = light_of("random"), torch.zeros(4, 4, 1)
    surface, hit, _, drawn = draw(light, roughness)
    terms = drawn.terms[drawn.texel >= 0]
    assert (terms[:, 1:3] == 0).all()
    assert torch.isfinite(terms).all()
    assert float(terms[:, 0].max()) > 0
    leaves = [leaf.requires_grad_() for leaf in (uniform(7, 7, 3, seed=4), roughness, light.radiance.clone())]
    found = shade_samples(surface, drawn, Material(*leaves[:2]), leaves[2], "layered", made_up_object(drawn))
    assert (found.specular[hit] == 0).all()
    for gradient in torch.autograd.grad(sum(values[hit].sum() for values in found), leaves):
        assert torch.isfinite(gradient).all()


# ---------------------------------------------------------------- shading
@dataclass(frozen=True)
class Case:
    """What is shaded."""

    light: str = "random"
    coat: str = "layered"
    metallic: bool = True
    indirect: bool = True


CASES = [
    Case(),
    Case(light="sun"),
    Case(light="black"),
    Case(coat="added"),
    Case(metallic=False),
    Case(indirect=False),
    Case(coat="added", metallic=False, indirect=False),
]


def leaves_of(case: Case, drawn: DirectionSamples) -> dict[str, Tensor]:
    """All that shading is differentiable in."""
    material = made_up_material(metallic=case.metallic, coat=case.coat)
    leaves = {"albedo": material.albedo, "roughness": material.roughness, "radiance": light_of(case.light).radiance}
    if material.metallic is not None:
        leaves["metallic"] = material.metallic
    if case.indirect:
        of_object = made_up_object(drawn)
        leaves |= {"arriving": of_object.arriving, "leaving": of_object.leaving}
    return leaves


def shade(case: Case, by: str) -> tuple[list[Tensor], dict[str, Tensor]]:
    """The four results of every hit, by "kernels" or "torch", and the leaves that they depend on."""
    light = light_of(case.light)
    surface, hit, _, drawn = draw(light, made_up_material(metallic=case.metallic, coat=case.coat).roughness)
    dtype = torch.float32 if by == "kernels" else torch.float64
    leaves = {name: leaf.to(dtype).requires_grad_() for name, leaf in leaves_of(case, drawn).items()}
    material = Material(leaves["albedo"], leaves["roughness"], leaves.get("metallic"))
    of_object = made_up_object(drawn)._replace(**{n: leaves[n] for n in ("arriving", "leaving")}) if case.indirect else None
    if by == "kernels":
        found = shade_samples(surface, drawn, material, leaves["radiance"], case.coat, of_object)
    else:
        points, valid = exact(surface), drawn.texel >= 0
        direction = torch.where(valid[..., None], drawn.direction.double(), points.normal[:, None])
        roughness, texel = reference.fetch(material.roughness.detach(), points.uv), drawn.texel.clamp_min(0).long()
        weight = reference.weigh_directions(points.normal, points.view, roughness, direction, texel, light.sampler)
        weight = weight * valid[..., None]
        found = reference.shade(points, direction, texel, weight, material, leaves["radiance"], case.coat, of_object)
    return [values[hit] for values in found], leaves


def shaded(case: Case, by: str) -> tuple[list[Tensor], dict[str, Tensor]]:
    """The same, and the gradients of a random combination of the results."""
    results, leaves = shade(case, by)
    towards = [uniform(*values.shape, seed=20 + k).to(values) - 0.3 for k, values in enumerate(results)]
    total = sum((values * toward).sum() for values, toward in zip(results, towards, strict=True))
    gradients = torch.autograd.grad(total, list(leaves.values()))
    return [values.detach() for values in results], dict(zip(leaves, gradients, strict=True))


@pytest.mark.parametrize("case", CASES, ids=str)
def test_values_and_gradients(case: Case) -> None:
    found, wanted = (shaded(case, by) for by in ("kernels", "torch"))
    for ours, theirs in zip(found[0], wanted[0], strict=True):
        assert_near(ours, theirs)
    assert float(wanted[0][3].max()) > 0.5
    assert (float(wanted[0][2].max()) > 0) == case.indirect
    for name, gradient in wanted[1].items():
        assert gradient.shape == found[1][name].shape
        assert_near(found[1][name], gradient)
        assert float(gradient.abs().max()) > 0, name


@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_number_of_threads_changes_rounding_alone(case: Case) -> None:
    before, results = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            results.append(shaded(case, "kernels"))
    finally:
        torch.set_num_threads(before)
    one, two = results
    for first, second in zip(one[0], two[0], strict=True):
        assert torch.equal(first, second)
    for name, gradient in one[1].items():
        assert_near(two[1][name], gradient, 1e-5)


@pytest.mark.parametrize("part", range(4))
def test_one_result_alone_has_its_gradient(part: int) -> None:
    """The gradients of the others are nothing, not what the memory held."""
    gradients = []
    for by in ("kernels", "torch"):
        results, leaves = shade(Case(), by)
        gradients.append(torch.autograd.grad(results[part].sum(), list(leaves.values()), allow_unused=True))
    for found, wanted in zip(*gradients, strict=True):
        assert_near(found, torch.zeros_like(found) if wanted is None else wanted)


def test_a_second_derivative_is_refused() -> None:
    """It is none that the kernels have, and no silent zero."""
    light = light_of("random")
    surface, _, _, drawn = draw(light, made_up_material(metallic=False).roughness)
    material = made_up_material(metallic=False)
    albedo = material.albedo.requires_grad_()
    found = shade_samples(surface, drawn, material, light.radiance, "added", None)
    (gradient,) = torch.autograd.grad(found.diffuse.square().sum(), albedo, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        gradient.sum().backward()


# ---------------------------------------------------------------- the light's texels
def test_texels_of_directions() -> None:
    direction = torch.nn.functional.normalize(torch.randn(20_000, 3, generator=torch.Generator().manual_seed(30)), dim=-1)
    for height, width in ((1, 1), (9, 14), (256, 512)):
        found = kernel_calls.direction_to_texel(direction, height, width)
        wanted = direction_to_texel(direction.double(), height, width)
        assert float((found != wanted).float().mean()) < 2e-3
