"""Surface points lit by spherical Gaussians, in closed form: a Lambertian lobe, and GGX as one Gaussian more.

(Zhang et al. 2021, PhySG, and Zhang et al. 2022, InvRender.) What a smooth lobe makes of light is exact up to the fits of
lobes.py; what is left out is the shape of GGX beside a Gaussian, and the change of Fresnel and masking across a lobe.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ia_bench.material.brdf import dot
from ia_bench_baselines.common.spherical_gaussians.lobes import SphericalGaussians, clamped_cosine_integral, product

GRAZING = 1e-6  # beside 4 n . v, where the view lies in the surface


@dataclass(frozen=True)
class Gloss:
    """How the Gaussian of a GGX lobe is scaled; the defaults are PhySG's.

    Attributes:
        reflectance: F0, at normal incidence.
        gain: Factor of the normalised amplitude 1 / (pi roughness^4). InvRender has a gain of 2 with a reflectance of .02, which
            reflects at normal incidence what .04 does with a gain of 1, and at grazing views up to twice as much.
    """

    reflectance: float = 0.04
    gain: float = 1.0


def irradiance(lobes: SphericalGaussians, normal: Tensor, visibility: Tensor | None = None) -> Tensor:
    """The irradiance (N, 3) at N surface points; ``visibility`` (N, M) is the share of every lobe that arrives."""
    arriving = clamped_cosine_integral(lobes.sharpness, lobes.cosines(normal))
    return lobes.weighted(arriving if visibility is None else arriving * visibility).clamp_min(0)


def glossy(lobes: SphericalGaussians, normal: Tensor, view: Tensor, roughness: Tensor, gloss: Gloss = Gloss()) -> Tensor:
    """Radiance (N, 3) that the GGX lobe reflects toward ``view`` (N, 3), without shadows; ``roughness`` (N, 1), perceptual."""
    axis, sharpness, amplitude = reflected_lobe(normal, view, roughness, gloss)
    both, share = product(lobes.sharpness, sharpness, lobes.cosines(axis))
    leaning = (lobes.sharpness * lobes.cosines(normal) + sharpness * dot(axis, normal)) / both
    arriving = share * clamped_cosine_integral(both, leaning.clamp(-1, 1))  # it is a cosine, but for rounding
    return amplitude * lobes.weighted(arriving).clamp_min(0)


def reflected_lobe(normal: Tensor, view: Tensor, roughness: Tensor, gloss: Gloss) -> tuple[Tensor, Tensor, Tensor]:
    """GGX as a Gaussian over directions of light: axis (N, 3), sharpness (N, 1), amplitude (N, 1) with Fresnel and masking.

    Around the half vector its sharpness is 2 / alpha^2, alpha = roughness^2. Turned into a lobe around the mirrored view, it is
    wider by 4 n . v. There the half vector is the normal, so that F and G / (4 (n . v)(n . l)) are functions of n . v alone:
    Schlick's F in the form of Karis (2013), with 6.8316 for his 6.98316 as PhySG has it, and Schlick's G with
    k = (roughness + 1)^2 / 8.
    """
    cosine = dot(normal, view).clamp_min(0)
    alpha2 = roughness**4
    sharpness = 2 / alpha2 / (4 * cosine + GRAZING)
    fresnel = gloss.reflectance + (1 - gloss.reflectance) * torch.exp2(-(5.55473 * cosine + 6.8316) * cosine)
    k = (roughness + 1) ** 2 / 8
    masking = 1 / (4 * (cosine * (1 - k) + k) ** 2)
    return 2 * cosine * normal - view, sharpness, gloss.gain / (math.pi * alpha2) * fresnel * masking
