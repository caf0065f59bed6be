"""With everything else true the albedo that is solved for is the true one; wrong highlights and unknown pixels do not pull."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from small_fit import SETTINGS, Record, altered, coupled, fit, oracle
from torch import Tensor

from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.methods.contract import Coupling, FitState, NoCoupling, Problem, Regulariser
from ia_bench.methods.couplings.kernel import Kernel
from ia_bench.methods.couplings.targets import Targets
from ia_bench.methods.two_stage.least_squares import conjugate_gradients, solved_albedo
from ia_bench.priors.contract import NoPrior
from ia_bench.scenes.scene import Scene

SIDE = 64
SAMPLES = 256
Known = tuple[Problem, Material, SampledLight, Tensor]  # photographs, and of what they are


@pytest.fixture(scope="module")
def known(problem: Problem) -> Known:
    """Photographs (P, 3) of a made-up material and light, without indirect light, and these two."""
    renderer = problem.renderer.__class__(problem.renderer.surface, problem.renderer.rays)
    problem = altered(problem, renderer=renderer, plan=replace(problem.plan, samples=SAMPLES))
    paint = torch.rand(SIDE // 4, SIDE // 4, 3, generator=torch.Generator().manual_seed(0)) * 0.6 + 0.2
    paint = torch.nn.functional.interpolate(paint.permute(2, 0, 1)[None], size=(SIDE, SIDE), mode="bilinear")[0].permute(1, 2, 0)
    material = Material(paint.contiguous(), torch.full((SIDE, SIDE, 1), 0.6))
    light = SampledLight.of(torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(1)) + 0.5)
    return problem, material, light, photographed(problem, material, light)


def photographed(problem: Problem, material: Material, light: SampledLight) -> Tensor:
    values = problem.renderer.render_entries(problem.gbuffer, material, light, SAMPLES, torch.Generator().manual_seed(2))
    return values["radiance"]


def taking(problem: Problem, radiance: Tensor, known: Tensor | None = None) -> Problem:
    """The same with other photographs (P, 3)."""
    known = problem.photographs.known if known is None else known
    return altered(problem, photographs=replace(problem.photographs, radiance=radiance, known=known))


def error(problem: Problem, albedo: Tensor, truth: Tensor) -> float:
    """Root of the mean square in the pixels that the object fills."""
    gbuffer = problem.gbuffer.at(torch.nonzero(problem.gbuffer.filled)[:, 0])
    shown = problem.renderer.surface.averaged(gbuffer.face, gbuffer.barycentric, (albedo - truth).contiguous())
    return float(shown.square().mean().sqrt())


def solve(
    known: Known, *, images: Tensor | None = None, valid: Tensor | None = None, exposures: Tensor | None = None
) -> tuple[float, float]:
    """The errors of an albedo with noise, before and after."""
    problem, material, light, photographs = known
    noise = 0.2 * torch.rand(material.albedo.shape, generator=torch.Generator().manual_seed(5)) - 0.1
    begun = replace(material, albedo=material.albedo + noise)
    images = photographs if images is None else images
    found = solved_albedo(taking(problem, images, valid), exposures, begun, light, torch.Generator().manual_seed(3))
    return error(problem, begun.albedo, material.albedo), error(problem, found, material.albedo)


def test_the_true_albedo_is_found_also_of_photographs_with_exposures_of_their_own(known: Known) -> None:
    before, after = solve(known)
    assert after < 0.4 * before
    problem, *_, photographs = known
    exposures = torch.linspace(-0.3, 0.3, problem.gbuffer.shape[0]).exp()[:, None]
    images = exposures[problem.gbuffer.view()] * photographs
    before, after = solve(known, images=images, exposures=exposures)
    assert after < 0.4 * before


def test_what_is_unknown_or_off_by_far_does_not_pull(known: Known) -> None:
    *_, photographs = known
    wrong = torch.rand(len(photographs), 1, generator=torch.Generator().manual_seed(4)) < 0.1
    broken = torch.where(wrong, 20 * photographs, photographs)
    before, after = solve(known, images=broken)
    assert after < 0.5 * before
    unknown = solve(known, images=broken, valid=~wrong)[1]
    assert unknown < 0.5 * before


@pytest.mark.parametrize("brightness", [0.0, 1e-6, 1e6])
def test_black_and_bright_lights_leave_it_finite(known: Known, brightness: float) -> None:
    problem, material, light, photographs = known
    lit = SampledLight.of(brightness * light.radiance)
    found = solved_albedo(taking(problem, brightness * photographs), None, material, lit, torch.Generator())
    assert bool(((found >= 0) & (found <= 1)).all())
    torch.testing.assert_close(error(problem, found, material.albedo), 0.0, atol=0.05, rtol=0)


def test_conjugate_gradients_solve_each_channel() -> None:
    """Beside numpy, in float64."""
    random = np.random.default_rng(0)
    root = random.normal(size=(2, 16, 16))
    matrices = root @ root.transpose(0, 2, 1) + 4 * np.eye(16)
    right = random.normal(size=(2, 16))
    wanted = np.linalg.solve(matrices, right[..., None])[..., 0]

    def matrix(texture: Tensor) -> Tensor:
        return torch.einsum("cij,jc->ic", torch.from_numpy(matrices), texture.reshape(16, 2)).reshape(4, 4, 2)

    found = conjugate_gradients(matrix, torch.from_numpy(right.T.copy()).reshape(4, 4, 2), 40)
    np.testing.assert_allclose(found.reshape(16, 2).T, wanted, atol=1e-8)


def test_a_fit_takes_it_once_at_the_end(problem: Problem) -> None:
    alone = coupled(problem, NoCoupling())
    plain, solved = (fit(alone, NoPrior(), replace(SETTINGS, solve_albedo=on), Record()) for on in (False, "auto"))
    assert torch.equal(plain.light, solved.light)
    assert torch.equal(plain.material.roughness, solved.material.roughness)
    assert not torch.equal(plain.material.albedo, solved.material.albedo)


class OneGrey(Regulariser):
    """A regulariser that leaves one albedo everywhere, when all steps are done."""

    def apply(self, material: Material, state: FitState) -> Material:
        return replace(material, albedo=torch.full_like(material.albedo, 0.5))


def test_it_comes_after_the_last_regulariser(problem: Problem) -> None:
    """What the photographs show comes back, which nothing but a solution could do."""
    grey, alone = replace(SETTINGS, regularise=[f"{__name__}:OneGrey"]), coupled(problem, NoCoupling())
    kept, solved = (fit(alone, NoPrior(), replace(grey, solve_albedo=on), Record()).material.albedo for on in (False, "auto"))
    assert bool((kept == 0.5).all())
    assert float((solved - 0.5).abs().max()) > 0.05


@pytest.mark.parametrize(
    ("coupling", "solved"),
    [(Kernel(), True), (Targets(), False), (Targets(albedo=0), True)],
    ids=["kernel", "targets", "targets of specular shading alone"],
)
def test_what_says_the_albedo_is_overruled_where_it_is_asked_for(
    problem: Problem, scene: Scene, coupling: Coupling, solved: bool
) -> None:
    """By the photographs alone."""

    def counts(on: bool | str) -> bool:
        result = fit(coupled(problem, coupling), oracle(scene), replace(SETTINGS, solve_albedo=on), Record())
        return "solved_albedo_clamped" in result.counters

    assert (counts("auto"), counts(True), counts(False)) == (solved, True, False)
