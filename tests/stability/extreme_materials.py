"""The BRDF and its sampling at the ends of roughness, at grazing angles, and for vectors that are none."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from stability.case import Case, Measured, all_finite, deviation
from torch import Tensor

from ia_bench.material.brdf import (
    MIN_ROUGHNESS,
    dot,
    normalize,
    sample_visible_ggx,
    specular_brdf_cosine,
    tangent_frame,
    visible_ggx_pdf,
)

GROUP = "BRDF"
COUNT = 4096
STEP = 1e-5  # of the central differences in roughness, float64


def cases() -> Iterator[Case]:
    """All of them."""
    value, double = "specular BRDF x cosine", "float64; gradient: differences"
    for roughness in (MIN_ROUGHNESS, 0.1, 0.5, 1.0):
        extreme = f"roughness {roughness:g}, around the lobe"
        yield Case(GROUP, extreme, value, double, 2e-3, lambda r=roughness: _precision(r, None), 5e-3)
    yield Case(GROUP, "roughness 0, off the mirror direction", value, "0", 0.0, _mirror)
    for cosine in (1e-1, 1e-2, 1e-3, 1e-4, 1e-6):
        extreme = f"view at cosine {cosine:g}, roughness 0.3"
        yield Case(GROUP, extreme, value, double, 2e-3, lambda c=cosine: _precision(0.3, c), 5e-3)
    yield Case(GROUP, "light below the horizon", value, "0; gradient: 0", 0.0, _below, 0.0)
    yield Case(GROUP, "light opposite to the view (no half vector)", value, "finite", 1.0, _no_half_vector)
    yield Case(GROUP, "zero vector", "normalize", "0; gradient: finite", 0.0, _zero_vector)
    yield Case(GROUP, "normals at both poles and 1e-7 beside", "tangent frame", "orthonormal", 1e-6, _frames)
    for roughness in (MIN_ROUGHNESS, 0.1, 0.5, 1.0):
        extreme, quantity = f"roughness {roughness:g}, view from the normal to grazing", "reflected energy beyond 1"
        yield Case(GROUP, extreme, quantity, "0", 0.0, lambda r=roughness: _energy(r))
        quantity = "share of samples without density"
        yield Case(GROUP, extreme, quantity, "0", 0.0, lambda r=roughness: _densities(r))


def _pairs(roughness: float, cosine: float | None) -> tuple[Tensor, Tensor, Tensor]:
    """Normals, views and incident directions (COUNT, 3) float32, the last drawn from the lobe itself."""
    generator = torch.Generator().manual_seed(0)
    normal = normalize(torch.randn(COUNT, 3, generator=generator))
    tangent, bitangent = tangent_frame(normal)
    height = torch.rand(COUNT, 1, generator=generator) * 0.95 + 0.05 if cosine is None else torch.full((COUNT, 1), cosine)
    azimuth = 2 * torch.pi * torch.rand(COUNT, 1, generator=generator)
    side = (1 - height**2).sqrt()
    view = normalize(side * azimuth.cos() * tangent + side * azimuth.sin() * bitangent + height * normal)
    drawn = torch.rand(COUNT, 2, generator=generator)
    incident = normalize(sample_visible_ggx(normal, view, torch.full((COUNT, 1), roughness), drawn))
    above = dot(normal, incident)[:, 0] > 1e-3  # nearer to the horizon the float32 input itself decides
    return normal[above], view[above], incident[above]


def _precision(roughness: float, cosine: float | None) -> Measured:
    vectors = _pairs(roughness, cosine)
    single = torch.full((len(vectors[0]), 1), roughness, requires_grad=True)
    value = specular_brdf_cosine(*vectors, single)
    (gradient,) = torch.autograd.grad(value.sum(), single)
    value = value.detach()

    def exact(offset: float) -> Tensor:
        normal, view, incident = (vector.double() for vector in vectors)
        return specular_brdf_cosine(normal, view, incident, torch.full_like(normal[:, :1], roughness + offset))

    slope = (exact(STEP) - exact(-STEP)) / (2 * STEP)
    error = deviation(value, exact(0.0), 1e-3 * float(value.max()))
    return Measured(error, deviation(gradient, slope, 1e-3 * float(slope.abs().max())), finite=all_finite(value, gradient))


def _mirror() -> Measured:
    vectors = _pairs(0.5, None)
    roughness = torch.zeros(len(vectors[0]), 1, requires_grad=True)
    value = specular_brdf_cosine(*vectors, roughness)
    (gradient,) = torch.autograd.grad(value.sum(), roughness)
    return Measured(float(value.detach().abs().max()), finite=all_finite(value, gradient))


def _below() -> Measured:
    normal, view, incident = _pairs(0.5, None)
    roughness = torch.full((len(normal), 1), 0.5, requires_grad=True)
    value = specular_brdf_cosine(normal, view, incident - 2 * dot(normal, incident) * normal, roughness)
    (gradient,) = torch.autograd.grad(value.sum(), roughness)
    return Measured(float(value.detach().abs().max()), float(gradient.abs().max()), finite=all_finite(value, gradient))


def _no_half_vector() -> Measured:
    normal, view, _ = _pairs(0.5, 1e-6)
    roughness = torch.full((len(normal), 1), 0.3, requires_grad=True)
    incident = (-view).requires_grad_(True)
    value = specular_brdf_cosine(normal, view, incident, roughness)
    gradients = torch.autograd.grad(value.sum(), (roughness, incident))
    return Measured(float(value.detach().abs().max()), finite=all_finite(value, *gradients))


def _zero_vector() -> Measured:
    vector = torch.zeros(1, 3, requires_grad=True)
    unit = normalize(vector)
    (gradient,) = torch.autograd.grad(unit.sum(), vector)
    return Measured(float(unit.detach().abs().max()), finite=all_finite(unit, gradient))


def _frames() -> Measured:
    near = [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1e-7, 0.0, -1.0), (0.0, -1e-7, -1.0), (1e-7, 1e-7, 1.0), (1.0, 0.0, 0.0)]
    normal = normalize(torch.tensor(near))
    axes = torch.stack([*tangent_frame(normal), normal], 1)
    error = (axes @ axes.transpose(1, 2) - torch.eye(3)).abs().max()
    return Measured(float(error), finite=all_finite(axes))


def _sampled(roughness: float) -> tuple[Tensor, Tensor]:
    """Value over density of BRDF samples above the horizon, and these densities, for views from the normal to grazing."""
    generator = torch.Generator().manual_seed(0)
    height = torch.tensor([1.0, 0.5, 0.1, 1e-2, 1e-3]).repeat_interleave(COUNT)[:, None]
    view = torch.cat([(1 - height**2).sqrt(), torch.zeros_like(height), height], 1)
    normal = torch.tensor([0.0, 0.0, 1.0]).expand_as(view)
    rough = torch.full_like(height, roughness)
    incident = sample_visible_ggx(normal, view, rough, torch.rand(len(view), 2, generator=generator))
    density = visible_ggx_pdf(normal, view, incident, rough)
    ratio = specular_brdf_cosine(normal, view, incident, rough) / density
    above = incident[:, 2:] > 0
    return torch.where(above, ratio, 0.0).reshape(5, COUNT), torch.where(above, density, 1.0).reshape(5, COUNT)


def _energy(roughness: float) -> Measured:
    ratio, _ = _sampled(roughness)
    return Measured(max(0.0, float(ratio.mean(1).max()) - 1), finite=all_finite(ratio))


def _densities(roughness: float) -> Measured:
    _, density = _sampled(roughness)
    return Measured(float((density <= 0).double().mean()), finite=all_finite(density))
