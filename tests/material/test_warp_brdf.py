"""The BRDF of the kernels: its samples and its numbers against those of torch in float64 (test_brdf.py, test_brdf_sampling.py)."""

import kernel_calls
import pytest
import torch
from half_vectors import DEGREES, DRAWS, RENDERED, UP, random_pairs, view_at

from benchmarks.reference import specular_lobes
from ia_bench.material.brdf import dot, sample_visible_ggx, visible_ggx_pdf

pytestmark = pytest.mark.verify


def drawn_at(roughness: float, degrees: float, u: torch.Tensor) -> tuple[tuple[torch.Tensor, torch.Tensor], torch.Tensor]:
    """The kernel's directions (N, 3) seen along a view at an angle from +z, and normal and view."""
    seen = UP.float().expand(len(u), 3), view_at(degrees).float().expand(len(u), 3)
    return seen, kernel_calls.sample_visible_ggx(*seen, torch.full((1, 1), roughness), u)


@pytest.mark.parametrize("degrees", DEGREES)
@pytest.mark.parametrize("roughness", RENDERED)
def test_the_kernel_draws_what_float64_draws(roughness: float, degrees: float) -> None:
    """From the same numbers the same directions, 99.9 % of them to 2e-5 and all to 2e-3; those above have a density."""
    u = torch.rand(DRAWS, 2, generator=torch.Generator().manual_seed(14))
    seen, drawn = drawn_at(roughness, degrees, u)
    exact = sample_visible_ggx(*(v.double() for v in seen), torch.full((DRAWS, 1), roughness).double(), u.double())
    error = (drawn.double() - exact).norm(dim=-1)
    assert float(error.quantile(0.999)) < 2e-5
    assert float(error.max()) < 2e-3
    density = kernel_calls.lobe(*seen, drawn, torch.full((1, 1), roughness))[3]
    assert (density[drawn[:, 2] > 0] > 0).all()


@pytest.mark.parametrize("roughness", RENDERED)
def test_the_lobe_against_float64(roughness: float) -> None:
    """Value, slope in alpha, grazing part and density: as many digits as the lobe leaves of an ulp in the directions.

    As test_float32_against_float64 of test_brdf.py has it.
    """
    view, incident = (v.float() for v in random_pairs(4000, 9, roughness))
    seen = (dot(view, incident)[:, 0] > -0.99) & (incident[:, 2] > 1e-3)
    pairs = UP.float().expand(int(seen.sum()), 3), view[seen], incident[seen]
    value, slope, grazing, density = (part.double() for part in kernel_calls.lobe(*pairs, torch.full((1, 1), roughness)))
    exact = tuple(v.double() for v in pairs)
    alike = torch.full((int(seen.sum()), 1), roughness).double().requires_grad_()
    base, edge = specular_lobes(*exact, alike)
    (by_roughness,) = torch.autograd.grad((base + edge).sum(), alike)
    wanted = (base + edge).detach()
    close = 100 * torch.finfo(torch.float32).eps / roughness**2 + 2e-5
    torch.testing.assert_close(value, wanted, rtol=close, atol=1e-12)
    torch.testing.assert_close(density, visible_ggx_pdf(*exact, alike.detach()), rtol=close, atol=1e-12)
    scale = (wanted / roughness).clamp_min(1e-12)
    torch.testing.assert_close(2 * roughness * slope / scale, by_roughness / scale, rtol=0, atol=5 * close)
    shown = wanted > 1e-12
    torch.testing.assert_close(grazing[shown], (edge.detach() / wanted)[shown], rtol=1e-4, atol=1e-6)
