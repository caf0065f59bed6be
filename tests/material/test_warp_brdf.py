"""The BRDF of the kernels: its samples and its numbers against those of torch in float64 (test_brdf.py, test_brdf_sampling.py)."""

from __future__ import annotations

import math

import kernel_calls
import pytest
import torch
from half_vectors import DEGREES, DRAWS, RENDERED, UP, random_pairs, view_at

from benchmarks.reference import specular_lobes
from ia_bench.material.brdf import MIN_ROUGHNESS, dot, normalize, sample_visible_ggx, visible_ggx_pdf

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


GRAZING = normalize(torch.tensor([1.0, 0.0, 1e-7]))
FLAT = torch.tensor([1.0, 0.0, 0.0])
Z = torch.tensor([0.0, 0.0, 1.0])


@pytest.mark.parametrize("roughness", [0.0, *RENDERED])
@pytest.mark.parametrize(
    ("view", "incident"),
    [
        (Z, Z),  # n.h = 1
        (-GRAZING, GRAZING),  # opposite: no half vector
        (GRAZING, GRAZING),
        (GRAZING, normalize(torch.tensor([-1.0, 0.0, 1e-7]))),  # the mirror direction at grazing
        (FLAT, Z),
        (-Z, Z),  # seen from behind
        (normalize(torch.tensor([1.0, 1.0, -1e-3])), GRAZING),
    ],
)
def test_extremes_are_finite(view: torch.Tensor, incident: torch.Tensor, roughness: float) -> None:
    parts = torch.cat(kernel_calls.lobe(Z[None], view[None], incident[None], torch.full((1, 1), roughness)), -1)
    assert torch.isfinite(parts).all()
    assert (parts[:, [0, 2, 3]] >= 0).all()
    u = torch.rand(500, 2, generator=torch.Generator().manual_seed(0))
    drawn = kernel_calls.sample_visible_ggx(Z.expand(500, 3), view.expand(500, 3), torch.full((1, 1), roughness), u)
    assert torch.isfinite(drawn).all()


def test_a_perfect_mirror_reflects_the_view() -> None:
    u = torch.rand(100, 2, generator=torch.Generator().manual_seed(12))
    for degrees in DEGREES:
        (_, view), drawn = drawn_at(0.0, degrees, u)
        torch.testing.assert_close(drawn, view * torch.tensor([-1.0, -1.0, 1.0]), atol=1e-6, rtol=0)
        value, slope, _, density = kernel_calls.lobe(UP.float().expand(100, 3), view, drawn, torch.zeros(1, 1))
        assert float(torch.cat([value, slope, density]).abs().max()) == 0


def test_cosine_and_sine_by_a_polynomial() -> None:
    """To 1e-7 over the four turns that it is good for, at the eighths where its pieces meet too."""
    turns = torch.cat([torch.linspace(-2, 2, 100_001), torch.arange(-16, 17) / 8])
    for near in (turns, torch.nextafter(turns, torch.tensor(9.0)).clamp(-2, 2)):
        angle = 2 * torch.pi * near.double()
        exact = torch.stack([angle.cos(), angle.sin()], -1)
        assert float((kernel_calls.turn(near).double() - exact).abs().max()) < 1.2e-7


def test_the_narrowest_lobe_is_resolved() -> None:
    """At MIN_ROUGHNESS the value at the mirror direction is the closed form's 1 / (4 pi alpha^2 cos) times masking, to 1 %."""
    alpha = MIN_ROUGHNESS**2
    for degrees in (5, 45, 80):
        view = view_at(degrees).float()[None]
        mirror = view * torch.tensor([-1.0, -1.0, 1.0])
        value = kernel_calls.lobe(UP.float()[None], view, mirror, torch.full((1, 1), MIN_ROUGHNESS))[0]
        cosine = math.cos(math.radians(degrees))
        masking = 1 / (1 + (math.sqrt(1 + alpha**2 * math.tan(math.radians(degrees)) ** 2) - 1))
        assert float(value) == pytest.approx(masking / (4 * math.pi * alpha**2 * cosine), rel=0.01)
