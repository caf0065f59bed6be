"""A lat-long light approximated by spherical Gaussians, which is how methods of such a light meet one that is given.

InvRender and PhySG take 100 000 Adam steps of raw parameters, because a sharpness of hundreds is far from its start at a rate
of .01. Here logarithms of sharpness and amplitude are fitted, and the amplitudes are solved for at the end: seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.optimize import lsq_linear, nnls
from torch import Tensor

from ia_bench.common.cache import Cache, content_key, made_on
from ia_bench.light.environment import Environment
from ia_bench.light.latlong import row_solid_angles, texel_centres
from ia_bench.material.brdf import normalize
from ia_bench_baselines.common.spherical_gaussians.lobes import SphericalGaussianEnvironment, SphericalGaussians, fibonacci_axes

ROWS = 64  # of the map that is fitted
LOBES, STEPS, RATE = 128, 400, 0.05
FIRST_SHARPNESS, LARGEST_SHARPNESS = 30.0, 2000.0  # a lobe of the latter is narrower than a texel
NORMALS = 64  # at which irradiance is compared
BALANCED, BALANCE = 128, 10.0  # other normals, at which irradiance is asked for, and the weight of that beside radiance
UNLIT = 0.01  # of the mean irradiance; a normal with less tells nothing by a relative error


@dataclass(frozen=True)
class Residual:
    """What a light lost when it was fitted, as shares of the true values; all are 0 for a perfect fit.

    Attributes:
        mean: Mean error of the irradiance over NORMALS normals spread over the sphere and over channels, each relative to the
            irradiance of its normal.
        worst: The largest of them.
        energy: Error of the whole power, with its sign.
    """

    mean: float
    worst: float
    energy: float


def fit_light(light: Environment, count: int = LOBES) -> SphericalGaussians:
    """``count`` spherical Gaussians that approximate ``light`` in the least squares over solid angle.

    Deterministic; kept in the cache by the light's content, for the code of this folder. :func:`residual` says what was lost.
    """
    radiance = light.latlong(ROWS).detach()
    code = [path.read_text(encoding="utf-8") for path in sorted(Path(__file__).parent.glob("*.py"))]
    key = content_key(made_on(radiance.device.type, "spherical_gaussians"), *code, f"{count} {STEPS}", radiance.cpu())
    kept = Cache().kept(key, lambda: {name: part.cpu() for name, part in _fit(radiance, count)._asdict().items()})
    return SphericalGaussians(**{name: part.to(radiance.device) for name, part in kept.items()})


def residual(radiance: Tensor, lobes: SphericalGaussians) -> Residual:
    """How far ``lobes`` are from a map (H, W, 3), by quadrature over the map's texels."""
    centres, solid_angle = _grid(radiance)
    found = SphericalGaussianEnvironment(lobes).latlong(len(radiance)).reshape(-1, 3)
    true = radiance.reshape(-1, 3)
    arriving = (fibonacci_axes(NORMALS).to(radiance) @ centres.T).clamp_min(0) * solid_angle
    expected, power = arriving @ true, float((solid_angle @ true).sum())
    if power == 0:
        return Residual(0.0, 0.0, 0.0)
    level = expected.mean(1, keepdim=True)
    error = (arriving @ found - expected).abs() / torch.maximum(level, UNLIT * level.mean())
    return Residual(float(error.mean()), float(error.max()), float((solid_angle @ found).sum()) / power - 1)


# ---- the fit ---------------------------------------------------------------------------------------------------------


@torch.enable_grad()  # whoever renders under a light has it off
def _fit(radiance: Tensor, count: int) -> SphericalGaussians:
    centres, solid_angle = _grid(radiance)
    target = radiance.reshape(-1, 3)
    scale = float((solid_angle @ target).mean() / (4 * math.pi))
    if scale <= 0:  # there is no light: nothing to be fitted
        dark = radiance.new_zeros(count, 3)
        return SphericalGaussians(fibonacci_axes(count).to(radiance), torch.full_like(dark[:, 0], FIRST_SHARPNESS), dark)
    target, weight = target / scale, solid_angle / solid_angle.sum()

    # start: even lobes, each as bright as what it covers
    axis = fibonacci_axes(count).to(radiance)
    sharpness = torch.full((count,), math.log(FIRST_SHARPNESS), device=radiance.device)
    cover = torch.exp(FIRST_SHARPNESS * (axis @ centres.T - 1)) * weight
    overlap = FIRST_SHARPNESS * 2 / count  # of even lobes, whose sum is 1 where each has this amplitude
    amplitude = torch.log(overlap * (cover @ target) / cover.sum(1, keepdim=True) + 1e-4)

    # axes and widths: Adam
    parameters = [part.requires_grad_() for part in (axis, sharpness, amplitude)]
    adam = torch.optim.Adam(parameters, lr=RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, STEPS)
    for _ in range(STEPS):
        error = SphericalGaussians(normalize(axis), sharpness.exp(), amplitude.exp()).radiance(centres) - target
        adam.zero_grad()
        (weight[:, None] * error * error).sum().backward()
        adam.step()
        schedule.step()
        with torch.no_grad():
            sharpness.clamp_(max=math.log(LARGEST_SHARPNESS))
    axis, sharpness = normalize(axis.detach()), sharpness.detach().exp()
    return SphericalGaussians(axis, sharpness, scale * _amplitudes(axis, sharpness, radiance / scale))


def _amplitudes(axis: Tensor, sharpness: Tensor, target: Tensor) -> Tensor:
    """The non-negative amplitudes of least squares for given axes and sharpnesses and a map (H, W, 3): (M, 3), in float64.

    The squares are those of the errors of radiance over solid angle, and of irradiance at BALANCED normals: where a sun is
    smaller than the narrowest lobe, the radiance alone would have it too bright.
    """
    one_each = SphericalGaussians(axis, sharpness, torch.eye(len(axis), device=axis.device))  # a channel for every lobe
    basis = SphericalGaussianEnvironment(one_each).latlong(len(target)).reshape(-1, len(axis)).double()
    centres, solid_angle = _grid(target.double())
    arriving = (fibonacci_axes(BALANCED).to(centres) @ centres.T).clamp_min(0) * solid_angle
    weight = torch.cat([(solid_angle / (4 * math.pi)).sqrt()[:, None], arriving.new_full((BALANCED, 1), BALANCE)])
    values = target.reshape(-1, 3).double()
    system = (weight * torch.cat([basis, arriving @ basis])).cpu().numpy()
    wanted = (weight * torch.cat([values, arriving @ values])).cpu().numpy()
    rotation, triangle = np.linalg.qr(system)  # nnls then sees M rows instead of all texels
    found = np.stack([_not_negative(triangle, channel) for channel in (rotation.T @ wanted).T], 1)
    return torch.from_numpy(found).to(axis)


def _not_negative(system: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The least squares of ``system`` x = ``wanted`` among x >= 0."""
    try:
        found: np.ndarray = nnls(system, wanted, maxiter=100 * len(system))[0]
    except RuntimeError:  # its active set goes round in circles where lobes are nearly alike; an interior method does not
        found = lsq_linear(system, wanted, bounds=(0, np.inf)).x
    return found


def _grid(radiance: Tensor) -> tuple[Tensor, Tensor]:
    """Directions (T, 3) of a map's texels, and their solid angles (T,)."""
    height, width, _ = radiance.shape
    centres = texel_centres(height, width).reshape(-1, 3).to(radiance)
    return centres, row_solid_angles(height, width).repeat_interleave(width).to(radiance)
