"""The BRDF and its sampling at the ends of roughness, at grazing angles, and for vectors that are none."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import kernel_calls
import torch
from stability.case import Case, Measured, all_finite, deviation
from torch import Tensor

from ia_bench.material.brdf import (
    F0,
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
    for kind, by in ((value, _by_torch), (f"{value}, kernel", _by_kernel)):
        for roughness in (MIN_ROUGHNESS, 0.1, 0.5, 1.0):
            extreme = f"roughness {roughness:g}, around the lobe"
            yield Case(GROUP, extreme, kind, double, 2e-3, lambda b=by, r=roughness: _precision(b, r, None), 5e-3)
        yield Case(GROUP, "roughness 0, off the mirror direction", kind, "0", 0.0, lambda b=by: _mirror(b))
        for cosine in (1e-1, 1e-2, 1e-3, 1e-4, 1e-6):
            extreme = f"view at cosine {cosine:g}, roughness 0.3"
            yield Case(GROUP, extreme, kind, double, 2e-3, lambda b=by, c=cosine: _precision(b, 0.3, c), 5e-3)
    yield Case(GROUP, "light below the horizon", value, "0; gradient: 0", 0.0, _below, 0.0)
    yield Case(GROUP, "light opposite to the view (no half vector)", value, "finite", 1.0, _no_half_vector)
    yield Case(GROUP, "zero vector", "normalize", "0; gradient: finite", 0.0, _zero_vector)
    yield Case(GROUP, "zero vector", "normalize, kernel", "0", 0.0, _zero_vector_of_kernel)
    poles = "normals at both poles and 1e-7 beside"
    yield Case(GROUP, poles, "tangent frame", "orthonormal", 1e-6, lambda: _frames(tangent_frame))
    yield Case(GROUP, poles, "tangent frame, kernel", "orthonormal", 1e-6, lambda: _frames(kernel_calls.tangent_frame))
    for where, sampled in (("", _sampled_by_torch), (", kernel", _sampled_by_kernel)):
        for roughness in (MIN_ROUGHNESS, 0.1, 0.5, 1.0):
            extreme, quantity = f"roughness {roughness:g}, view from the normal to grazing", f"reflected energy beyond 1{where}"
            yield Case(GROUP, extreme, quantity, "0", 0.0, lambda s=sampled, r=roughness: _energy(s, r))
            quantity = f"share of samples without density{where}"
            yield Case(GROUP, extreme, quantity, "0", 0.0, lambda s=sampled, r=roughness: _densities(s, r))


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


Vectors = tuple[Tensor, Tensor, Tensor]


def _by_torch(vectors: Vectors, roughness: float) -> tuple[Tensor, Tensor]:
    """Value and slope in the roughness, (N, 1) each."""
    single = torch.full((len(vectors[0]), 1), roughness, requires_grad=True)
    value = specular_brdf_cosine(*vectors, single)
    (slope,) = torch.autograd.grad(value.sum(), single)
    return value.detach(), slope


def _by_kernel(vectors: Vectors, roughness: float) -> tuple[Tensor, Tensor]:
    """The same from a kernel's lobe, whose slope is that in alpha."""
    value, slope, grazing, _ = kernel_calls.lobe(*vectors, torch.full((len(vectors[0]), 1), roughness))
    fresnel = F0 * (1 - grazing) + grazing
    return value * fresnel, 2 * roughness * slope * fresnel


def _precision(by: Callable[[Vectors, float], tuple[Tensor, Tensor]], roughness: float, cosine: float | None) -> Measured:
    vectors = _pairs(roughness, cosine)
    value, gradient = by(vectors, roughness)

    def exact(offset: float) -> Tensor:
        normal, view, incident = (vector.double() for vector in vectors)
        return specular_brdf_cosine(normal, view, incident, torch.full_like(normal[:, :1], roughness + offset))

    slope = (exact(STEP) - exact(-STEP)) / (2 * STEP)
    error = deviation(value, exact(0.0), 1e-3 * float(value.max()))
    return Measured(error, deviation(gradient, slope, 1e-3 * float(slope.abs().max())), finite=all_finite(value, gradient))


def _mirror(by: Callable[[Vectors, float], tuple[Tensor, Tensor]]) -> Measured:
    value, gradient = by(_pairs(0.5, None), 0.0)
    return Measured(float(value.abs().max()), finite=all_finite(value, gradient))


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


def _zero_vector_of_kernel() -> Measured:
    unit = kernel_calls.normalize(torch.zeros(1, 3))
    return Measured(float(unit.abs().max()), finite=all_finite(unit))


def _frames(tangent_frame: Callable[[Tensor], tuple[Tensor, Tensor]]) -> Measured:
    near = [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1e-7, 0.0, -1.0), (0.0, -1e-7, -1.0), (1e-7, 1e-7, 1.0), (1.0, 0.0, 0.0)]
    normal = normalize(torch.tensor(near))
    axes = torch.stack([*tangent_frame(normal), normal], 1)
    error = (axes @ axes.transpose(1, 2) - torch.eye(3)).abs().max()
    return Measured(float(error), finite=all_finite(axes))


def _grazing_views(roughness: float) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Normals, views from the normal to grazing, roughness and random numbers of 5 COUNT samples."""
    height = torch.tensor([1.0, 0.5, 0.1, 1e-2, 1e-3]).repeat_interleave(COUNT)[:, None]
    view = torch.cat([(1 - height**2).sqrt(), torch.zeros_like(height), height], 1)
    normal = torch.tensor([0.0, 0.0, 1.0]).expand_as(view)
    drawn = torch.rand(len(view), 2, generator=torch.Generator().manual_seed(0))
    return normal, view, torch.full_like(height, roughness), drawn


def _above(incident: Tensor, value: Tensor, density: Tensor) -> tuple[Tensor, Tensor]:
    """Value over density of BRDF samples above the horizon, and these densities, (5, COUNT) each."""
    above = incident[:, 2:] > 0
    return torch.where(above, value / density, 0.0).reshape(5, COUNT), torch.where(above, density, 1.0).reshape(5, COUNT)


def _sampled_by_torch(roughness: float) -> tuple[Tensor, Tensor]:
    normal, view, rough, drawn = _grazing_views(roughness)
    incident = sample_visible_ggx(normal, view, rough, drawn)
    value = specular_brdf_cosine(normal, view, incident, rough)
    return _above(incident, value, visible_ggx_pdf(normal, view, incident, rough))


def _sampled_by_kernel(roughness: float) -> tuple[Tensor, Tensor]:
    normal, view, rough, drawn = _grazing_views(roughness)
    incident = kernel_calls.sample_visible_ggx(normal, view, rough, drawn)
    value, _, grazing, density = kernel_calls.lobe(normal, view, incident, rough)
    return _above(incident, value * (F0 * (1 - grazing) + grazing), density)


def _energy(sampled: Callable[[float], tuple[Tensor, Tensor]], roughness: float) -> Measured:
    ratio, _ = sampled(roughness)
    return Measured(max(0.0, float(ratio.mean(1).max()) - 1), finite=all_finite(ratio))


def _densities(sampled: Callable[[float], tuple[Tensor, Tensor]], roughness: float) -> Measured:
    _, density = sampled(roughness)
    return Measured(float((density <= 0).double().mean()), finite=all_finite(density))
