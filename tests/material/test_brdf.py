"""The BRDF against closed forms, quadrature in float64, and chi-square tests of its sampling.

Quadrature is over half vectors h with slope(h) = alpha tan(q) (cos a, sin a): GGX is sin(2q) in (q, a) for any alpha,
so that a grid resolves every lobe, however narrow. Roughness goes down to 1e-4 (alpha = 1e-8) in float64, and to
MIN_ROUGHNESS, where the renderer stops, in the renderer's float32; 0 is a mirror without a density. Solid angles follow
from d omega_h = cos^3 d slope and, for the mirrored direction, d omega_i = 4 (o.h) d omega_h.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from chi_square import assert_frequencies
from scipy.integrate import quad
from torch import Tensor

from ia_bench.material.brdf import (
    F0,
    MIN_ROUGHNESS,
    dot,
    fresnel_schlick,
    ggx_ndf,
    normalize,
    sample_visible_ggx,
    smith_g1,
    specular_brdf_cosine,
    tangent_frame,
    visible_ggx_pdf,
)

pytestmark = pytest.mark.verify

ROUGHNESS = (1e-4, 1e-3, 1e-2, MIN_ROUGHNESS, 0.1, 0.3, 0.6, 1.0)
RENDERED = [roughness for roughness in ROUGHNESS if roughness >= MIN_ROUGHNESS]
DEGREES = (5, 45, 80, 89, 89.9, 89.99)  # the last has a cosine of 1.7 MIN_COSINE
UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
RINGS, SECTORS, NODES = 10, 16, 24  # cells of the chi-square grid, Gauss nodes along each side of a cell
DRAWS = 100_000


def view_at(degrees: float) -> Tensor:
    """A view direction at an angle from the normal +z, off the axes."""
    theta, phi = math.radians(degrees), 0.7
    return torch.tensor(
        [math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)], dtype=torch.float64
    )


def half_vector_grid(roughness: float) -> tuple[Tensor, Tensor]:
    """Half vectors (R, S, N, N, 3) of Gauss nodes in R rings of q and S sectors of a; their solid angles."""
    node, weight = (torch.from_numpy(a) for a in np.polynomial.legendre.leggauss(NODES))
    node, weight = (node + 1) / 2, weight / 2
    q = (torch.arange(RINGS)[:, None] + node) * (math.pi / 2 / RINGS)
    a = (torch.arange(SECTORS)[:, None] + node) * (2 * math.pi / SECTORS)
    alpha = roughness**2
    slope = alpha * torch.tan(q)
    shape = (RINGS, SECTORS, NODES, NODES)
    across = slope[:, None, :, None].expand(shape)
    angle = a[None, :, None, :].expand(shape)
    half = normalize(torch.stack([across * angle.cos(), across * angle.sin(), torch.ones(shape)], -1).double())
    area = alpha**2 * torch.tan(q) / torch.cos(q) ** 2  # slope d slope = alpha^2 tan(q) / cos(q)^2 dq
    cell = (area * weight * (math.pi / 2 / RINGS))[:, None, :, None] * (weight * 2 * math.pi / SECTORS)[
        None, None, None, :
    ]
    return half, half[..., 2] ** 3 * cell


def mirrored(half: Tensor, view: Tensor) -> tuple[Tensor, Tensor]:
    """Incident directions that h mirrors the view into, and d omega_i / d omega_h (zero where h faces away)."""
    cosine = dot(view.expand_as(half), half)
    return 2 * cosine * half - view, 4 * cosine[..., 0].clamp_min(0)


def cells_of(half: np.ndarray, roughness: float) -> np.ndarray:
    """Index of the grid's cell of each half vector."""
    q = np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2] * roughness**2)
    ring = np.clip((q / (np.pi / 2) * RINGS).astype(int), 0, RINGS - 1)
    sector = (np.arctan2(half[:, 1], half[:, 0]) % (2 * np.pi) / (2 * np.pi) * SECTORS).astype(int) % SECTORS
    return ring * SECTORS + sector


def rough(value: float) -> Tensor:
    return torch.tensor([value], dtype=torch.float64)


# ---------------------------------------------------------------- sampling and density
@pytest.mark.parametrize("degrees", DEGREES)
@pytest.mark.parametrize("roughness", ROUGHNESS)
def test_samples_follow_their_density(roughness: float, degrees: float) -> None:
    """Chi-square over 160 cells of half vectors.

    Drawn in float32, as the renderer does, where float32 directions tell the cell: not below its range of roughness, nor
    nearer to grazing, where a drawn direction may almost be that of the view and the half vector is lost.
    """
    view = view_at(degrees)
    half, solid_angle = half_vector_grid(roughness)
    incident, jacobian = mirrored(half, view)
    pdf = visible_ggx_pdf(UP, view, incident, rough(roughness))[..., 0]
    expected = DRAWS * (pdf * jacobian * solid_angle).sum((2, 3))

    kind = torch.float32 if roughness in RENDERED and degrees <= 89 else torch.float64
    u = torch.rand(DRAWS, 2, generator=torch.Generator().manual_seed(5), dtype=kind)
    normal, seen = UP.to(kind).expand(DRAWS, 3), view.to(kind).expand(DRAWS, 3)
    drawn = sample_visible_ggx(normal, seen, torch.full((DRAWS, 1), roughness, dtype=kind), u)
    assert (visible_ggx_pdf(normal, seen, drawn, torch.full((DRAWS, 1), roughness, dtype=kind)) > 0).all()
    drawn = drawn.double()
    torch.testing.assert_close(drawn.norm(dim=-1), torch.ones(DRAWS, dtype=torch.float64), atol=1e-5, rtol=0)
    halves = normalize(drawn + view.to(kind).double())
    counts = np.bincount(cells_of(halves.numpy(), roughness), minlength=RINGS * SECTORS)
    assert_frequencies(counts, expected.numpy(), tests=len(ROUGHNESS) * len(DEGREES))


@pytest.mark.parametrize("degrees", DEGREES)
@pytest.mark.parametrize("roughness", RENDERED)
def test_float32_draws_what_float64_draws(roughness: float, degrees: float) -> None:
    """From the same numbers the same directions, 99.9 % of them to 2e-5 and all to 2e-3, each with a density."""
    u = torch.rand(DRAWS, 2, generator=torch.Generator().manual_seed(14))
    single = [v.float().expand(DRAWS, -1) for v in (UP, view_at(degrees))], torch.full((DRAWS, 1), roughness)
    double = [v.double() for v in single[0]], single[1].double()
    drawn = sample_visible_ggx(*single[0], single[1], u)
    error = (drawn.double() - sample_visible_ggx(*double[0], double[1], u.double())).norm(dim=-1)
    assert float(error.quantile(0.999)) < 2e-5
    assert float(error.max()) < 2e-3
    assert (visible_ggx_pdf(*single[0], drawn, single[1]) > 0).all()


@pytest.mark.parametrize("degrees", DEGREES)
@pytest.mark.parametrize("roughness", ROUGHNESS)
def test_density_integrates_to_one_over_all_and_less_above_the_horizon(roughness: float, degrees: float) -> None:
    """Heitz' weak white furnace: the visible normals are a distribution. Reflections below the horizon are lost."""
    view = view_at(degrees)
    half, solid_angle = half_vector_grid(roughness)
    incident, jacobian = mirrored(half, view)
    mass = visible_ggx_pdf(UP, view, incident, rough(roughness))[..., 0] * jacobian * solid_angle
    assert float(mass.sum()) == pytest.approx(1, abs=5e-4)
    above = float(mass[incident[..., 2] > 0].sum())
    assert above <= 1 + 5e-4
    assert above > 0.4


def test_density_is_the_same_for_a_turned_frame() -> None:
    """Sampling and density do not depend on how the tangent frame happens to lie."""
    rng = torch.Generator().manual_seed(6)
    normal = normalize(torch.randn(64, 3, generator=rng, dtype=torch.float64))
    tangent, bitangent = tangent_frame(normal)
    frame = torch.stack([tangent, bitangent, normal], -1)
    eye = torch.eye(3, dtype=torch.float64)
    torch.testing.assert_close(frame.mT @ frame, eye.expand(64, 3, 3))
    torch.testing.assert_close(torch.linalg.det(frame), torch.ones(64, dtype=torch.float64))
    view, incident = view_at(50), view_at(-20)
    turned = [(frame @ v) for v in (view, incident)]
    here = visible_ggx_pdf(UP, view, incident, rough(0.4)), specular_brdf_cosine(UP, view, incident, rough(0.4))
    there = visible_ggx_pdf(normal, *turned, rough(0.4)), specular_brdf_cosine(normal, *turned, rough(0.4))
    for a, b in zip(here, there, strict=True):
        torch.testing.assert_close(a.expand_as(b), b)


@pytest.mark.parametrize("z", [1.0, -1.0, 1e-8, -1e-8, -0.9999999])
def test_tangent_frame_has_no_pole(z: float) -> None:
    normal = normalize(torch.tensor([1e-4, 0.0, z]) if abs(z) > 0.5 else torch.tensor([1.0, 0.0, z]))
    frame = torch.stack([*tangent_frame(normal), normal], -1)
    torch.testing.assert_close(frame.T @ frame, torch.eye(3), atol=1e-5, rtol=0)


# ---------------------------------------------------------------- energy
@pytest.mark.parametrize("roughness", ROUGHNESS)
def test_ggx_is_normalised(roughness: float) -> None:
    """The integral of D(h) (n.h) over the hemisphere is 1, by scipy over the logarithm of the tangent."""

    def integrand(log_tangent: float) -> float:
        theta = math.atan(math.exp(log_tangent))
        half = torch.tensor([math.sin(theta), 0, math.cos(theta)], dtype=torch.float64)
        d = float(ggx_ndf(UP, half, rough(roughness) ** 2))
        return d * math.cos(theta) * 2 * math.pi * math.sin(theta) * math.sin(theta) * math.cos(theta)

    centre = math.log(roughness**2)
    total, _ = quad(integrand, centre - 20, centre + 20, limit=200)
    assert total == pytest.approx(1, abs=1e-6)


LOSS = {
    1e-4: (0, 1e-7),
    1e-3: (0, 1e-6),
    1e-2: (0, 1e-4),
    0.03: (0, 0.001),
    0.1: (0, 0.01),
    0.3: (0.001, 0.1),
    0.6: (0.1, 0.25),
    1.0: (0.25, 0.7),
}
"""Share of the energy that single scattering loses between 5 and 80 degrees, per roughness: smallest, largest."""


@pytest.mark.parametrize("roughness", ROUGHNESS)
def test_white_furnace(roughness: float) -> None:
    """A perfect mirror of micro facets (F = 1) in a white world returns at most 1, and loses what LOSS states.

    The loss is light that would scatter twice between facets: no compensation is made for it. With Fresnel, the mean of
    value over density of samples is the energy by quadrature (at 4 sigma: a false alarm in 3e-3 of all runs of this family),
    and no sample returns more than its light had.
    """
    count = 20_000
    u = torch.rand(count, 2, generator=torch.Generator().manual_seed(11), dtype=torch.float64)
    losses = []
    for degrees in DEGREES:
        view = view_at(degrees)
        half, solid_angle = half_vector_grid(roughness)
        incident, jacobian = mirrored(half, view)
        value = specular_brdf_cosine(UP, view, incident, rough(roughness))[..., 0]
        fresnel = fresnel_schlick(dot(view.expand_as(half), half).clamp(0, 1))[..., 0]
        energy = float((value / fresnel * jacobian * solid_angle).sum())
        assert energy <= 1 + 5e-4
        real = float((value * jacobian * solid_angle).sum())
        assert real < energy
        seen = UP.expand(count, 3), view.expand(count, 3)
        drawn, alike = sample_visible_ggx(*seen, rough(roughness).expand(count, 1), u), rough(roughness)
        ratio = specular_brdf_cosine(*seen, drawn, alike) / visible_ggx_pdf(*seen, drawn, alike)
        assert float(ratio.max()) <= 1 + 1e-6  # F G2 / G1
        assert abs(float(ratio.mean()) - real) < 4 * float(ratio.std()) / math.sqrt(count) + 5e-4 * real
        losses.append(1 - energy)
    low, high = LOSS[roughness]
    assert low - 5e-4 <= min(losses[:3])
    assert max(losses[:3]) <= high + 5e-4


def test_a_mirror_has_samples_and_no_density() -> None:
    """Roughness 0: the mirror direction itself, value and density 0 there and everywhere, gradients finite."""
    u = torch.rand(100, 2, generator=torch.Generator().manual_seed(12), dtype=torch.float64)
    for degrees in DEGREES:
        view, roughness = view_at(degrees), torch.zeros(1, dtype=torch.float64, requires_grad=True)
        mirror = view * torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64)
        drawn = sample_visible_ggx(UP.expand(100, 3), view.expand(100, 3), torch.zeros(100, 1, dtype=torch.float64), u)
        torch.testing.assert_close(drawn, mirror.expand(100, 3), atol=1e-12, rtol=0)
        value = specular_brdf_cosine(UP, view, torch.stack([mirror, view, UP]), roughness)
        assert (value == 0).all()
        assert (visible_ggx_pdf(UP, view, drawn, roughness) == 0).all()
        (gradient,) = torch.autograd.grad(value.sum(), roughness)
        assert float(gradient) == 0


def test_loss_at_normal_incidence_against_the_height_correlated_closed_form() -> None:
    """Seen along the normal, E = integral of D G2 (o.h) / ... reduces to one dimension, integrated by scipy.

    With o = n the Smith term is G1(i) (the viewer's side masks nothing), and the half vector is at half the angle.
    """
    for roughness in (0.3, 0.6, 1.0):
        alpha2 = roughness**4

        def integrand(theta: float, alpha2: float = alpha2) -> float:
            cos_h = math.cos(theta / 2)
            d = alpha2 / (math.pi * (cos_h**2 * (alpha2 - 1) + 1) ** 2)
            tan2 = math.tan(theta) ** 2
            g1 = 2 / (1 + math.sqrt(1 + alpha2 * tan2))
            return d * g1 / (4 * math.cos(theta)) * math.cos(theta) * 2 * math.pi * math.sin(theta)

        expected, _ = quad(integrand, 0, math.pi / 2, limit=200)
        half, solid_angle = half_vector_grid(roughness)
        incident, jacobian = mirrored(half, UP)
        value = specular_brdf_cosine(UP, UP, incident, rough(roughness))[..., 0]
        fresnel = fresnel_schlick(half[..., 2].clamp(0, 1))
        assert float((value / fresnel * jacobian * solid_angle).sum()) == pytest.approx(expected, abs=2e-3)


# ---------------------------------------------------------------- values
def reference(view: np.ndarray, incident: np.ndarray, roughness: float) -> float:
    """The specular BRDF times the cosine in the textbook's form: D F G2 / (4 cos_o), G2 = 1 / (1 + L(o) + L(i))."""
    if incident[2] <= 0:
        return 0.0
    alpha = roughness**2
    half = (view + incident) / np.linalg.norm(view + incident)

    def smith_lambda(w: np.ndarray) -> float:
        return (math.sqrt(1 + alpha**2 * (w[0] ** 2 + w[1] ** 2) / w[2] ** 2) - 1) / 2

    tan2 = (half[0] ** 2 + half[1] ** 2) / half[2] ** 2
    d = 1 / (math.pi * alpha**2 * half[2] ** 4 * (1 + tan2 / alpha**2) ** 2)
    g = 1 / (1 + smith_lambda(view) + smith_lambda(incident))
    f = 0.04 + 0.96 * (1 - view @ half) ** 5
    return d * g * f / (4 * view[2])


def random_pairs(count: int, seed: int, roughness: float) -> tuple[Tensor, Tensor]:
    """Random views above and incident directions anywhere, half of them inside the lobe; float64. Down to a cosine of 0.001."""
    rng = torch.Generator().manual_seed(seed)
    view = normalize(torch.randn(count, 3, generator=rng, dtype=torch.float64))
    view[::3, 2] = torch.logspace(-3, -1, len(view[::3]), dtype=torch.float64)
    view[:, 2] = view[:, 2].abs().clamp_min(1e-3)
    view = normalize(view)
    anywhere = torch.randn(count, 3, generator=rng, dtype=torch.float64)
    lobe = roughness**2 * view[:, 2:] * torch.randn(count, 3, generator=rng, dtype=torch.float64)
    near = view * torch.tensor([-1.0, -1.0, 1.0]) + lobe
    incident = torch.where(torch.arange(count)[:, None] % 2 == 0, anywhere, near)
    return view, normalize(incident)


def rounding(roughness: float, kind: torch.dtype = torch.float64) -> float:
    """Relative error that a lobe of width alpha makes of an ulp in the directions, and of a grazing cosine of 0.001."""
    return 30 * torch.finfo(kind).eps * (1e3 + 1 / roughness**2)


@pytest.mark.parametrize("roughness", ROUGHNESS)
def test_values_against_the_textbook(roughness: float) -> None:
    view, incident = random_pairs(400, 7, roughness)
    value = specular_brdf_cosine(UP, view, incident, rough(roughness))[:, 0]
    expected = [reference(o, i, roughness) for o, i in zip(view.numpy(), incident.numpy(), strict=True)]
    np.testing.assert_allclose(value.numpy(), expected, rtol=rounding(roughness), atol=1e-300)
    assert 0.1 < np.mean(np.array(expected) > 0) < 0.95  # both sides of the horizon are there


@pytest.mark.parametrize("roughness", ROUGHNESS)
def test_reciprocity(roughness: float) -> None:
    """f(o, i) = f(i, o), where f is the value over the incident cosine."""
    view, incident = random_pairs(400, 8, roughness)
    both = incident[:, 2] > 3e-4
    assert both.sum() > 200
    view, incident = view[both], incident[both]
    forth = specular_brdf_cosine(UP, view, incident, rough(roughness))[:, 0] / incident[:, 2]
    back = specular_brdf_cosine(UP, incident, view, rough(roughness))[:, 0] / view[:, 2]
    torch.testing.assert_close(forth, back, rtol=rounding(roughness), atol=0)


def test_fresnel_ends() -> None:
    assert float(fresnel_schlick(torch.tensor(1.0))) == pytest.approx(
        ((1.5 - 1) / (1.5 + 1)) ** 2
    )  # exact Fresnel, IOR 1.5
    assert float(fresnel_schlick(torch.tensor(0.0))) == pytest.approx(1)
    assert F0 == 0.04
    falling = fresnel_schlick(torch.linspace(0, 1, 100, dtype=torch.float64))
    assert (torch.diff(falling) < 0).all()


def test_masking_ends() -> None:
    assert float(smith_g1(torch.tensor(1.0), torch.tensor(0.5))) == pytest.approx(1)  # nothing is masked head on
    assert float(smith_g1(torch.tensor(1e-4), torch.tensor(1.0))) == pytest.approx(2e-4, rel=1e-3)
    assert float(smith_g1(torch.tensor(0.3), torch.tensor(0.0))) == pytest.approx(1)  # a flat mirror masks nothing


@pytest.mark.parametrize("roughness", ROUGHNESS[1:])
def test_float32_against_float64(roughness: float) -> None:
    """As many digits as the lobe leaves of an ulp in the directions: at MIN_ROUGHNESS 0.5 % of the value, below it fewer.

    Inputs are rounded first, so that what is compared is the arithmetic, not the rounding of the directions. Where light
    comes from behind the lobe (incident = -view) their sum has no digits; at roughness 1e-4 the lobe is below an ulp.
    """
    view, incident = (v.float() for v in random_pairs(4000, 9, roughness))
    seen = (dot(view, incident)[:, 0] > -0.99) & (incident[:, 2].abs() > 1e-3)
    pairs = UP.float(), view[seen], incident[seen]
    single = torch.full((int(seen.sum()), 1), roughness, requires_grad=True)
    double = single.detach().double().requires_grad_()
    tolerance = {"rtol": 100 * torch.finfo(torch.float32).eps / roughness**2 + 2e-5, "atol": 1e-12}
    values = [specular_brdf_cosine(*pairs, single), specular_brdf_cosine(*(v.double() for v in pairs), double)]
    torch.testing.assert_close(values[0].double(), values[1], **tolerance)
    densities = [visible_ggx_pdf(*pairs, single), visible_ggx_pdf(*(v.double() for v in pairs), double)]
    torch.testing.assert_close(densities[0].double(), densities[1], **tolerance)
    gradients = [torch.autograd.grad(value.sum(), r)[0] for value, r in zip(values, (single, double), strict=True)]
    scale = (values[1].detach() / roughness).clamp_min(1e-12)  # where it crosses zero, its digits are those of the value
    tolerance = {"rtol": 0, "atol": 5 * tolerance["rtol"]}
    torch.testing.assert_close(gradients[0].double() / scale, gradients[1] / scale, **tolerance)


# ---------------------------------------------------------------- gradients and extremes
@pytest.mark.parametrize("roughness", ROUGHNESS)
def test_gradients_against_finite_differences(roughness: float) -> None:
    """Central differences in float64 of roughness and of all three directions, each moved by a small share of the lobe."""
    view, incident = random_pairs(400, 10, roughness)
    above = incident[:, 2] > 1e-2 * view[:, 2].clamp_max(0.3)
    inputs = [UP.expand(int(above.sum()), 3), view[above], incident[above], rough(roughness).expand(int(above.sum()), 1)]
    inputs = [value.clone().requires_grad_() for value in inputs]
    assert len(inputs[0]) > 100
    value = specular_brdf_cosine(*inputs)
    gradients = torch.autograd.grad(value.sum(), inputs)
    rng = torch.Generator().manual_seed(13)
    moves = [torch.randn(v.shape, generator=rng, dtype=torch.float64) for v in inputs]
    grazing = torch.minimum(inputs[1][:, 2:], inputs[2][:, 2:]).detach()
    steps = [1e-4 * roughness**2 * grazing] * 3 + [1e-4 * rough(roughness)]
    for index, (gradient, move, step) in enumerate(zip(gradients, moves, steps, strict=True)):
        ends = []
        for sign in (1, -1):
            moved = [v.detach() for v in inputs]
            moved[index] = moved[index] + sign * step * move
            ends.append(specular_brdf_cosine(*moved))
        predicted = (gradient * move * step).sum(-1, keepdim=True) / value.detach()  # relative changes of the value
        measured = (ends[0] - ends[1]) / (2 * value.detach())
        torch.testing.assert_close(measured, predicted, rtol=2e-3, atol=1e-7 + 3 * rounding(roughness))


GRAZING = normalize(torch.tensor([1.0, 0.0, 1e-7]))
FLAT = torch.tensor([1.0, 0.0, 0.0])
Z = torch.tensor([0.0, 0.0, 1.0])


@pytest.mark.parametrize("roughness", ROUGHNESS)
@pytest.mark.parametrize(
    ("view", "incident"),
    [
        (Z, Z),  # n.h = 1
        (Z, -Z),  # opposite: no half vector
        (GRAZING, -GRAZING),
        (GRAZING, GRAZING),
        (GRAZING, normalize(torch.tensor([-1.0, 0.0, 1e-7]))),  # the mirror direction at grazing
        (FLAT, FLAT),
        (FLAT, -FLAT),
        (FLAT, Z),
        (-Z, Z),  # seen from behind
        (normalize(torch.tensor([1.0, 1.0, -1e-3])), GRAZING),
    ],
)
def test_extremes_are_finite_and_so_are_their_gradients(view: Tensor, incident: Tensor, roughness: float) -> None:
    r = torch.full((1,), roughness, requires_grad=True)
    value = specular_brdf_cosine(Z, view, incident, r)
    assert torch.isfinite(value).all()
    assert (value >= 0).all()
    pdf = visible_ggx_pdf(Z, view, incident, r.detach())
    assert torch.isfinite(pdf).all()
    assert (pdf >= 0).all()
    (gradient,) = torch.autograd.grad(value.sum(), r)
    assert torch.isfinite(gradient).all()
    for u in ([0.0, 0.0], [0.5, 1 - 2**-24], [1 - 2**-24, 0.5], [0.25, 0.0]):
        drawn = sample_visible_ggx(Z, view, r.detach(), torch.tensor(u))
        assert torch.isfinite(drawn).all()
        assert float(drawn.norm()) == pytest.approx(1, abs=1e-4)
