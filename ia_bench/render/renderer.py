"""The renderer used for training, scoring and relighting alike: G-buffer in, diffuse and specular radiance out."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material, fetch
from ia_bench.render.estimator import FromObject, draw_samples, shade_samples
from ia_bench.render.gbuffer import GBuffer, SurfaceInterpolator
from ia_bench.render.indirect import IndirectLight, Interreflection
from ia_bench.render.visibility import Visibility

POINTS_AT_ONCE = 2**18  # of a textured picture: about 50 MB
CHUNK = 4096  # pixels at a time where no gradient is needed ...
PASS_SAMPLES = 128  # ... with at most this many samples, in as many passes as will do


@dataclass(frozen=True)
class PixelRadiance:
    """Premultiplied values of P pixels, each (P, 3).

    ``diffuse`` radiance, indirect light included; ``specular`` radiance of the light itself, the paper's specular shading;
    ``mirrored``, specular radiance of the object in itself, None without indirect light; ``albedo``.
    """

    diffuse: Tensor
    specular: Tensor
    albedo: Tensor
    mirrored: Tensor | None = None

    @property
    def radiance(self) -> Tensor:
        """Everything that reaches the camera, (P, 3)."""
        shaded = self.diffuse + self.specular
        return shaded if self.mirrored is None else shaded + self.mirrored

    def exposed(self, factors: Tensor) -> PixelRadiance:
        """The same light times (P, 1) factors; the albedo stays."""
        mirrored = None if self.mirrored is None else factors * self.mirrored
        return PixelRadiance(factors * self.diffuse, factors * self.specular, self.albedo, mirrored)

    def averaged(self, estimates: int) -> PixelRadiance:
        """The mean of several estimates of the same pixels, one after another: (estimates P, 3) to (P, 3)."""

        def mean(values: Tensor) -> Tensor:
            return values.unflatten(0, (estimates, -1)).mean(0)

        mirrored = None if self.mirrored is None else mean(self.mirrored)
        return PixelRadiance(mean(self.diffuse), mean(self.specular), mean(self.albedo), mirrored)


class Renderer:
    """One mesh, its shadows and, where ``interreflection`` is given, the light that it throws onto itself.

    ``coat``: "added", the paper's sum of a diffuse and a specular lobe, or "layered": the specular lobe lies above the
    diffuse one, which is left what it does not reflect.
    """

    def __init__(
        self,
        surface: SurfaceInterpolator,
        visibility: Visibility,
        *,
        interreflection: Interreflection | None = None,
        coat: str = "added",
    ) -> None:
        self.surface = surface
        self.visibility = visibility
        self.interreflection = interreflection
        self.coat = coat

    def render_pixels(
        self, gbuffer: GBuffer, pixels: Tensor, material: Material, light: SampledLight, samples: int, generator: torch.Generator
    ) -> PixelRadiance:
        """Estimate the premultiplied radiance of (P,) entries of the G-buffer with ``samples`` directions a pixel.

        Every point of a pixel takes as many, at least two, so ``samples`` is rounded to a multiple of twice the points. An
        entry of -1 is none: it is black, and no ray is spent on it.
        """
        shift = lattice_shift(pixels, generator)
        return self._render(gbuffer, pixels, material, light, self._bounce(material, light), samples, shift)

    def _bounce(self, material: Material, light: SampledLight) -> IndirectLight | None:
        return None if self.interreflection is None else self.interreflection.solve(material.albedo, light.radiance)

    def _render(
        self,
        gbuffer: GBuffer,
        pixels: Tensor,
        material: Material,
        light: SampledLight,
        indirect: IndirectLight | None,
        samples: int,
        shift: Tensor,
        part: int = 0,
        parts: int = 1,
    ) -> PixelRadiance:
        """As :meth:`render_pixels`, for one of several parts of the lattices that start at ``shift`` (2, P, 3)."""
        points = gbuffer.subsamples
        count = samples_taken(samples, points) // (2 * points)
        with torch.no_grad():
            # ---- surface points, (N = P S, ...) ---------------------------------------------------------------
            face = gbuffer.face[pixels].masked_fill(pixels[:, None] < 0, -1).reshape(-1)
            camera = gbuffer.origin[gbuffer.pixel[pixels] // (gbuffer.shape[1] * gbuffer.shape[2])]
            surface = self.surface(face, gbuffer.barycentric[pixels].reshape(-1, 2), camera.repeat_interleave(points, 0))

            # ---- directions by light and by BRDF, (N, 2 count), and what is in their way -------------------------
            drawn = draw_samples(
                surface, face >= 0, material.roughness.detach(), light.sampler, shift,
                points=points, count=count, part=part, parts=parts,
            )  # fmt: skip
            blocked = self.visibility.blocked(surface, drawn.direction, drawn.texel >= 0)
            drawn.texel[blocked] = -1
            of_object = None
            if indirect is not None:
                assert self.interreflection is not None
                seen = self.interreflection.seen(surface, drawn.direction[:, count:], blocked[:, count:])
                of_object = FromObject(indirect.arriving, indirect.leaving, self.interreflection.atlas.row, seen)

        # ---- what reaches the camera, (N, 3), and its mean over the points of a pixel, (P, 3); a miss is black ------
        shaded = shade_samples(surface, drawn, material, light.radiance, self.coat, of_object)
        pool = (face >= 0).reshape(-1, points, 1) / points
        diffuse, specular, mirrored, albedo = ((part.reshape(-1, points, 3) * pool).sum(1) for part in shaded)
        return PixelRadiance(diffuse, specular, albedo, None if of_object is None else mirrored)

    @torch.no_grad()
    def render_images(
        self, gbuffer: GBuffer, material: Material, light: SampledLight, samples: int, generator: torch.Generator
    ) -> dict[str, Tensor]:
        """Whole images of all views, premultiplied, each (V, H, W, 3): "radiance" and the parts of :class:`PixelRadiance`.

        The samples of a pixel are one lattice, dealt out evenly to as few passes of at most PASS_SAMPLES as will do.
        """
        parts = ["diffuse", "specular", "albedo"] + ["mirrored"] * (self.interreflection is not None)
        images = {name: torch.zeros(*gbuffer.shape, 3, device=gbuffer.face.device).reshape(-1, 3) for name in parts}
        every = torch.arange(len(gbuffer.pixel), device=gbuffer.face.device)
        passes = -(-samples // PASS_SAMPLES)
        indirect = self._bounce(material, light)
        for chunk in every.split(CHUNK) if len(every) else ():
            padded = torch.cat([chunk, chunk.new_full((CHUNK - len(chunk),), -1)])
            shift = lattice_shift(padded, generator)
            for part in range(passes):
                each = round(samples / passes)
                rendered = self._render(gbuffer, padded, material, light, indirect, each, shift, part, passes)
                for name in parts:
                    images[name][gbuffer.pixel[chunk]] += getattr(rendered, name)[: len(chunk)] / passes
        images["radiance"] = sum((images[name] for name in parts if name != "albedo"), torch.zeros(()))
        return {name: image.reshape(*gbuffer.shape, 3) for name, image in images.items()}


def lattice_shift(pixels: Tensor, generator: torch.Generator) -> Tensor:
    """Random starts of the lattices of light and BRDF samples of (P,) pixels: (2, P, 3) float64."""
    return torch.rand(2, len(pixels), 3, generator=generator, dtype=torch.float64, device=pixels.device)


def texture_images(surface: SurfaceInterpolator, gbuffer: GBuffer, texture: Tensor) -> Tensor:
    """Premultiplied box-filtered pictures (V, H, W, C) of a texture (T, T, C) mapped onto the surface."""
    points = gbuffer.subsamples
    image = torch.zeros(*gbuffer.shape, texture.shape[-1], device=texture.device).reshape(-1, texture.shape[-1])
    parts = (part.split(POINTS_AT_ONCE // points) for part in (gbuffer.pixel, gbuffer.face, gbuffer.barycentric))
    for pixel, face, barycentric in zip(*parts, strict=True):
        uv = surface.uv(face.clamp_min(0).long(), barycentric)
        image[pixel] = (fetch(texture, uv) * (face >= 0)[..., None]).sum(1) / points
    return image.reshape(*gbuffer.shape, -1)


def samples_taken(samples: int, points: int) -> int:
    """How many of ``samples`` directions a pixel of ``points`` points takes: each point as many of the light as of the BRDF."""
    return 2 * points * max(1, round(samples / (2 * points)))
