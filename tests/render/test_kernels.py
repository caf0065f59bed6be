"""The kernels of the estimator against the same in torch (benchmarks/reference.py) in float64, with the same draws.

Points of all kinds are made up: seen from the normal to grazing, from in front and from behind, some of them misses, over
textures of different sizes with roughness at both of its ends. Values and gradients are compared at the float32 directions
that the kernels drew, because a narrow lobe changes by more than the tolerance from one float32 direction to the next.
"""

import math
from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from benchmarks import reference
from ia_bench.light.latlong import SampledLight
from ia_bench.material.brdf import MIN_ROUGHNESS, tangent_frame
from ia_bench.material.textures import Material
from ia_bench.render.estimator import DirectionSamples, FromObject, draw_samples, lattice, shade_samples
from ia_bench.render.gbuffer import SurfacePoints

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
    """The results of every hit, by "kernels" or "torch", and the leaves that they depend on."""
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
    return [values[hit] for values in vars(found).values() if values is not None], leaves


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
    assert float(wanted[0][2].max()) > 0.5
    assert len(wanted[0]) == len(found[0]) == 3 + case.indirect
    assert float(wanted[0][-1].max()) > 0  # with indirect light what is mirrored of the object
    for name, gradient in wanted[1].items():
        assert gradient.shape == found[1][name].shape
        assert_near(found[1][name], gradient)
        assert float(gradient.abs().max()) > 0, name


@pytest.mark.parametrize("component", [0, 1], ids=["diffuse", "specular"])
def test_the_slope_at_roughness_1_is_that_before_it(component: int) -> None:
    """Where the coat's table ends, and where fits hold a texel that would be rougher."""
    surface, _, _, drawn = draw(light_of("random"), torch.full((1, 1, 1), 0.9))

    def slope(rough: float) -> float:
        material = Material(torch.full((1, 1, 3), 0.5), torch.full((1, 1, 1), rough, requires_grad=True))
        shaded = shade_samples(surface, drawn, material, light_of("random").radiance, "layered", None)
        return float(torch.autograd.grad([*vars(shaded).values()][component].sum(), material.roughness)[0])

    assert slope(1.0) == pytest.approx(slope(0.9995), rel=0.01)
    assert abs(slope(1.0)) > 1e-3


# ---------------------------------------------------------------- the lattice
@pytest.mark.parametrize(("points", "count"), [(1, 16), (4, 8), (9, 3)])
def test_lattice_is_uniform_and_stratified(points: int, count: int) -> None:
    """Over random rotations every entry is uniform; in each pixel the first coordinate has one entry per stratum."""
    rotation = torch.rand(4000, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    samples = lattice(rotation, points, count)
    assert samples.shape == (4000, points, count, 3)
    assert 0 <= float(samples.min()) <= float(samples.max()) < 1
    assert float(samples.float().max()) < 1
    strata = (samples[..., 0].reshape(4000, -1) * points * count).long().sort(dim=1).values
    assert torch.equal(strata, torch.arange(points * count).expand(4000, -1))
    deviation = samples.mean(0) - 0.5  # of 4000 uniform numbers: sigma = 1 / sqrt(12 * 4000)
    assert float(deviation.abs().max()) < 5 / math.sqrt(12 * 4000)
    if count > 1:  # each point of the pixel alone spans the whole range
        spread = samples[..., 0].amax(2) - samples[..., 0].amin(2)
        assert float(spread.min()) > 1 - 2 / count
