"""The BRDF's values and gradients: the textbook in float64, reciprocity, both ends of every argument, finite differences."""

import numpy as np
import pytest
import textbook
import torch
from half_vectors import ROUGHNESS, UP, random_pairs, rough

from ia_bench.material.brdf import dot, specular_brdf_cosine, visible_ggx_pdf

pytestmark = pytest.mark.verify


# ---------------------------------------------------------------- values
def rounding(roughness: float, kind: torch.dtype = torch.float64) -> float:
    """Relative error that a lobe of width alpha makes of an ulp in the directions, and of a grazing cosine of 0.001."""
    return 30 * torch.finfo(kind).eps * (1e3 + 1 / roughness**2)


@pytest.mark.parametrize("roughness", ROUGHNESS)
def test_values_against_the_textbook(roughness: float) -> None:
    view, incident = random_pairs(400, 7, roughness)
    value = specular_brdf_cosine(UP, view, incident, rough(roughness))[:, 0]
    expected = textbook.specular(UP.numpy(), view.numpy(), incident.numpy(), roughness)
    np.testing.assert_allclose(value.numpy(), expected, rtol=rounding(roughness), atol=1e-300)
    assert 0.1 < np.mean(expected > 0) < 0.95  # both sides of the horizon are there


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
