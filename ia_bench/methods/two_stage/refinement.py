"""What photographs show, brought to the places of the surface that they show: a prior's corrections, and what tells it of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy

import torch
from torch import Tensor

from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material, fill_unobserved, splat
from ia_bench.methods.asking.views import restrict
from ia_bench.methods.bounds import known_pixels
from ia_bench.methods.contract import Problem
from ia_bench.render.renderer import texture_images
from ia_bench.scenes.scene import View

OFFSET = 0.01
"""It is added to both sides of a quotient of albedos, so that black ones have one."""
DARK = 0.02
"""This share of the mean of the photographs is added to both sides of a quotient of radiances, for the same reason."""
SAMPLES = 32
"""A pixel takes so many samples of the light in the pictures of a fit that are to be corrected."""


class Fusion:
    """Averages images of some training ``views`` over the pixels that show a texel.

    Each pixel is weighed by the cosine at which it sees the surface; those that the object covers in part are left out, and
    those that the photograph's mask leaves out, of which a prior has been shown nothing.

    Attributes:
        position: (P, 3), where the surface is that the pixels show.
    """

    def __init__(self, problem: Problem, views: tuple[int, ...]) -> None:
        part, rows = restrict(problem.gbuffer, views)
        covered = torch.nonzero(part.filled & ~problem.photographs.left_out[rows])[:, 0]
        self._surface = problem.renderer.surface
        self._pixel, self._face, self._barycentric = part.pixel[covered], part.face[covered], part.barycentric[covered]
        origin = part.seen_from(covered)
        middle = self._surface(self._face[:, 0].long(), self._barycentric[:, 0], origin)
        toward = origin - middle.position
        self.position = middle.position
        self._cosine = (middle.normal * toward).sum(-1, keepdim=True).clamp_min(0) / toward.norm(dim=-1, keepdim=True)

    def __bool__(self) -> bool:
        """Whether there is any such pixel."""
        return bool(len(self._pixel))

    def pixels(self, images: Tensor) -> Tensor:
        """The pixels (P, C) of images (V, H, W, C) that count."""
        return images.to(self._cosine.device).reshape(-1, images.shape[-1])[self._pixel]

    def drawn(self, most: int, generator: torch.Generator) -> Fusion:
        """The same of ``most`` of its pixels, drawn with the ``generator``; itself if it has no more."""
        if len(self._pixel) <= most:
            return self
        some, part = torch.randperm(len(self._pixel), generator=generator, device=self._pixel.device)[:most], copy(self)
        for name in ("position", "_pixel", "_face", "_barycentric", "_cosine"):
            setattr(part, name, getattr(self, name)[some])
        return part

    def looked_up(self, texture: Tensor) -> Tensor:
        """What the pixels show of a texture (T, T, C): (P, C)."""
        return self._surface.averaged(self._face, self._barycentric, texture)

    def mean(self, values: Tensor) -> Tensor:
        """(C,), over the pixels that ``values`` (P, C) belong to."""
        return (self._cosine * values).sum(0) / self._cosine.sum().clamp_min(1e-12)

    def texture(self, values: Tensor, size: int) -> Tensor:
        """``values`` (P, C) of the pixels as a texture (size, size, C); texels that none of them shows follow their neighbours."""
        channels = values.shape[1]
        uv = self._surface.uv(self._face.long(), self._barycentric)
        weighed = torch.cat([self._cosine * values, self._cosine], 1)[:, None].expand(-1, uv.shape[1], -1)
        summed, total = splat(uv.reshape(-1, 2), weighed.reshape(-1, channels + 1), size)
        known = (total > 0) & (summed[..., channels] > 0)
        return fill_unobserved(summed[..., :channels] / summed[..., channels:].clamp_min(1e-12), known)


def refined_albedo(fusion: Fusion, texture: Tensor, shown: Tensor, corrected: Tensor, share: float) -> Tensor:
    """The albedo ``texture`` (T, T, 3) as the pixels that show it were corrected from ``shown`` to ``corrected``, both (P, 3).

    A texel changes by the factor exp(share * mean of log((corrected + e) / (shown + e))) of albedos plus e = OFFSET. The mean
    factor of each channel is taken out, since no correction is asked about level and cast. What comes back may be out of [0, 1].
    """
    if not fusion:
        return texture
    change = torch.log(corrected.clamp_min(0) + OFFSET) - torch.log(shown.clamp_min(0) + OFFSET)
    mean = fusion.texture(change - fusion.mean(change), len(texture))
    return (texture + OFFSET) * torch.exp(share * mean) - OFFSET


def refined_roughness(fusion: Fusion, texture: Tensor, shown: Tensor, corrected: Tensor, share: float) -> Tensor:
    """The roughness ``texture`` (T, T, 1) likewise, ``shown`` and ``corrected`` (P, 1): plus share * mean change."""
    if not fusion:
        return texture
    return texture + share * fusion.texture(corrected - shown, len(texture))


def fitted_views(
    problem: Problem,
    fusion: Fusion,
    views: tuple[int, ...],
    material: Material,
    light: SampledLight,
    generator: torch.Generator,
    exposures: Tensor | None = None,
) -> dict[str, Tensor]:
    """What a fit shows in some training ``views``, those of the ``fusion``, as a prior is to correct it.

    The pictures are those of :meth:`ia_bench.priors.contract.Refiner.refine`; their :func:`evidence` is that of these photographs.
    ``exposures``: the factors (V,) by which the photographs of all training views were exposed; None where they are the same.
    """
    part, _ = restrict(problem.gbuffer, views)
    rendered = as_photographed(problem.renderer.render_images(part, material, light, SAMPLES, generator), views, exposures)
    together = evidence(fusion, [problem.scene.train[view] for view in views], rendered, len(material.albedo))
    images = {name: rendered[name] for name in ("albedo", "radiance", "specular")}
    for name, texture in (("roughness", material.roughness), ("evidence", together)):
        images[name] = texture_images(problem.renderer.surface, part, texture)
    return images


def as_photographed(renders: Mapping[str, Tensor], views: tuple[int, ...], exposures: Tensor | None) -> dict[str, Tensor]:
    """``renders`` (V', H, W, C) of some ``views`` with those that are radiance exposed as these photographs are."""
    if exposures is None:
        return dict(renders)
    factor = exposures[list(views), None, None, None]
    return {name: images if name == "albedo" else factor * images for name, images in renders.items()}


def evidence(fusion: Fusion, views: Sequence[View], renders: Mapping[str, Tensor], size: int) -> Tensor:
    """What photographs together say about each place: a texture (size, size, 2).

    ``views`` are those of the ``fusion``, ``renders`` a fit's "radiance" and "specular" (V, H, W, 3) in them. The first channel is
    its misfit, the root of the mean square of log((photograph + d) / (radiance + d)), of grey values, with d = DARK of the
    photographs' mean; pixels of which only a bound is known (:class:`ia_bench.scenes.scene.View`) have none. The second is how
    much of a highlight the place has been seen in: the root of the mean square of specular / (radiance + d). Means are those of
    :class:`Fusion`.
    """
    photographs = torch.stack([torch.from_numpy(view.image) for view in views])
    shown, radiance, specular = (
        fusion.pixels(images).mean(-1, keepdim=True) for images in (photographs, renders["radiance"], renders["specular"])
    )
    dark = DARK * shown.mean().clamp_min(1e-12)
    misfit = torch.log((shown.clamp_min(0) + dark) / (radiance.clamp_min(0) + dark))
    known = known_pixels(views)
    if known is not None:
        misfit = misfit * fusion.pixels(known)
    shine = specular / (radiance + dark)
    return fusion.texture(torch.cat([misfit, shine], 1).square(), size).clamp_min(0).sqrt()
