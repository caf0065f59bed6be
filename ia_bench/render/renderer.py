"""The renderer used for training, scoring and relighting alike: G-buffer in, diffuse and specular radiance out."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import torch
from torch import Tensor

from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.render.estimator import DirectionSamples, PixelRadiance, draw_samples, shade_samples
from ia_bench.render.gbuffer import GBuffer, SurfaceInterpolator, SurfacePoints
from ia_bench.render.indirect import IndirectLight, Interreflection
from ia_bench.render.light_rays import LightRays
from ia_bench.render.rays import RayCaster
from ia_bench.render.turns import TURNS, in_the_light, spread_turns, turns_of

CHUNK = 4096  # pixels at a time where no gradient is needed ...
PASS_SAMPLES = 128  # ... with at most this many samples, in as many passes as will do
RAY_CACHE_BYTES = 512 * 2**20  # of a BrdfRayCache


class BrdfRayCache:
    """What the directions by the BRDF meet in a picture: the same under every light, so it is traced once and kept.

    Pictures that share it must have everything else in common: views, samples, roughness, and the generator's seed. What does
    not fit into RAY_CACHE_BYTES is traced again for each.
    """

    def __init__(self) -> None:
        self._passes: list[tuple[Tensor, Tensor | None]] = []
        self._bytes, self._next = 0, 0

    def begin(self) -> None:
        """Go back to the first pass, for another picture."""
        self._next = 0

    def known(self) -> tuple[Tensor, Tensor | None] | None:
        """What the next pass found: (N, count) bool, whether the object is in the way, and (N, count) int32, the texel seen of it.

        The latter is None without indirect light. None in place of both: the pass has to be traced.
        """
        self._next += 1
        return self._passes[self._next - 1] if self._next <= len(self._passes) else None

    def keep(self, blocked: Tensor, seen: Tensor | None) -> None:
        """Keep what the pass that was not known has found, if it fits and those before it did."""
        size = blocked.nbytes + (0 if seen is None else seen.nbytes)
        if self._next == len(self._passes) + 1 and self._bytes + size <= RAY_CACHE_BYTES:
            self._bytes += size
            self._passes.append((blocked.clone(), seen))


class Renderer:
    """One mesh, its shadows and, where ``interreflection`` is given, the light that it throws onto itself.

    ``rays`` trace the shadows; None for none, as a convex object has them.
    ``coat``: "added", the paper's sum of a diffuse and a specular lobe, or "layered": the specular lobe lies above the
    diffuse one, which is left what it does not reflect.
    """

    def __init__(
        self,
        surface: SurfaceInterpolator,
        rays: RayCaster | None,
        *,
        interreflection: Interreflection | None = None,
        coat: str = "added",
    ) -> None:
        self.surface, self.rays, self.interreflection, self.coat = surface, rays, interreflection, coat
        self.ray_cache: BrdfRayCache | None = None
        self.light_rays: LightRays | None = None

    def keeping_rays(self, cache: BrdfRayCache, light_rays: LightRays | None) -> Renderer:
        """The same renderer for one picture under several lights: the first fills the cache, and the others use it.

        ``light_rays``: what is kept of this picture from run to run, None for a light that is of one run alone.
        """
        renderer = copy(self)
        renderer.ray_cache, renderer.light_rays = cache, light_rays
        return renderer

    def blocked(self, points: SurfacePoints, direction: Tensor, asked: Tensor) -> Tensor:
        """Whether the mesh is in the way of N points in K directions each, (N, K, 3): (N, K) bool, where it is ``asked`` for."""
        if self.rays is None:
            return torch.zeros_like(asked)
        return self.rays.occluded(self.surface.lifted(points), direction, asked)

    def render_pixels(
        self, gbuffer: GBuffer, pixels: Tensor, material: Material, light: SampledLight, samples: int, generator: torch.Generator
    ) -> PixelRadiance:
        """Estimate the premultiplied radiance of (P,) entries of the G-buffer with ``samples`` directions a pixel.

        Every point of a pixel takes as many, at least two, so ``samples`` is rounded to a multiple of twice the points. An
        entry of -1 is none: it is black, and no ray is spent on it.
        """
        rotation = random_rotation(pixels, generator)
        return self._render(gbuffer, pixels, material, light, self._bounce(gbuffer, material, light, TURNS), samples, rotation)

    def _bounce(self, gbuffer: GBuffer, material: Material, light: SampledLight, most: int | None = None) -> IndirectLight | None:
        """What the object throws onto itself; where the light turns, of ``most`` of the views' turns, which stand for others."""
        if self.interreflection is None:
            return None
        if light.turning is None:
            return self.interreflection.solve(material.albedo, light.radiance)
        turns = turns_of(gbuffer, light.turning)
        chosen, stand_in = spread_turns(turns, most)
        found = self.interreflection.solve(material.albedo, light.radiance, turns[chosen])
        return found._replace(first=(stand_in * len(self.interreflection.atlas.place)).int())

    def _render(
        self,
        gbuffer: GBuffer,
        pixels: Tensor,
        material: Material,
        light: SampledLight,
        indirect: IndirectLight | None,
        samples: int,
        rotation: Tensor,
        part: int = 0,
        parts: int = 1,
    ) -> PixelRadiance:
        """As :meth:`render_pixels`, for one of several parts of the lattices that ``rotation`` (2, P, 3) moves.

        For each point x of a pixel, seen from o, the estimate of equation 3 is a sum over directions w by light and by BRDF,

            L_o(x, o) = sum_w V(x, w) L(w) f(x, w, o) cos(w) / (n_light p_light(w) + n_brdf p_brdf(w)).

        Everything that is chosen by chance is chosen first, without gradient; the sum is then differentiable in textures and light.
        What it neglects: light that arrives from the object by way of its mirrored parts (see :mod:`ia_bench.render.indirect`).
        """
        points = gbuffer.subsamples
        count = samples_taken(samples, points) // (2 * points)
        with torch.no_grad():
            # ---------------- Surface points, N = P S: x, and o ----------------
            face = gbuffer.face[pixels].masked_fill(pixels[:, None] < 0, -1).reshape(-1)  # an entry of -1 is none
            camera = gbuffer.seen_from(pixels).repeat_interleave(points, 0)
            surface = self.surface(face, gbuffer.barycentric[pixels].reshape(-1, 2), camera)

            # ---------------- Directions, (N, 2 count): w by light, then by BRDF, with their weights ----------------
            view, lit = None, surface
            if light.turning is not None:  # what is lit is the object turned, in the light at rest
                view = gbuffer.view(pixels).repeat_interleave(points, 0)
                turn = turns_of(gbuffer, light.turning)[view]
                lit = in_the_light(surface, turn)
            drawn = draw_samples(
                lit, face >= 0, material.roughness.detach(), light.sampler, rotation,
                points=points, count=count, part=part, parts=parts,
            )  # fmt: skip
            if light.turning is not None:
                drawn = replace(drawn, direction=drawn.direction @ turn)  # and back into the object's coordinates

            # ---------------- Visibility, V = 0 where the object blocks the light ----------------
            blocked, seen = self._in_the_way(surface, drawn, count)

            # ---------------- Indirect light: what arrives from the object in the place of the light ----------------
            of_object = None if indirect is None or seen is None else indirect.seen_by(view, seen)

            # ---------------- The control variate: what it leaves for samples to estimate ----------------
            control = None if indirect is None else indirect.control_at(surface, face >= 0)
            if control is None:
                drawn.texel[blocked] = -1
            else:
                control.subtract(drawn, blocked)

        # ---------------- The sum, (N, 3), differentiable from here on ----------------
        steady = None if control is None else control.irradiance()
        shaded = shade_samples(surface, drawn, material, light.radiance, self.coat, of_object, steady)

        # ---------------- Pixels, (P, 3): the mean over their points, of which a miss is black ----------------
        pool = (face >= 0).reshape(-1, points, 1) / points
        return shaded.each(lambda values: (values.reshape(-1, points, 3) * pool).sum(1))

    def _in_the_way(self, surface: SurfacePoints, drawn: DirectionSamples, count: int) -> tuple[Tensor, Tensor | None]:
        """Whether the object blocks each sample, (N, 2 count) bool, and what of it the directions by the BRDF see, (N, count)."""
        asked = drawn.texel >= 0
        toward_light = surface.position, drawn.direction[:, :count], drawn.texel[:, :count]
        by_light = None if self.light_rays is None else self.light_rays.known(*toward_light)
        by_brdf, seen = (None if self.ray_cache is None else self.ray_cache.known()) or (None, None)
        for known, samples in ((by_light, slice(count)), (by_brdf, slice(count, None))):
            if known is not None:
                asked[:, samples] = False
        blocked = self.blocked(surface, drawn.direction, asked)
        if by_light is not None:
            blocked[:, :count] = by_light
        elif self.light_rays is not None:
            self.light_rays.keep(blocked[:, :count])
        if by_brdf is not None:
            blocked[:, count:] = by_brdf
            return blocked, seen
        if self.interreflection is not None:
            seen = self.interreflection.seen(surface, drawn.direction[:, count:], blocked[:, count:])
        if self.ray_cache is not None:
            self.ray_cache.keep(blocked[:, count:], seen)
        return blocked, seen

    @torch.no_grad()
    def render_images(
        self, gbuffer: GBuffer, material: Material, light: SampledLight, samples: int, generator: torch.Generator
    ) -> dict[str, Tensor]:
        """:meth:`render_entries` as whole images of all views, each (V, H, W, 3)."""
        values = self.render_entries(gbuffer, material, light, samples, generator)
        return {name: gbuffer.images(each) for name, each in values.items()}

    def render_entries(
        self, gbuffer: GBuffer, material: Material, light: SampledLight, samples: int, generator: torch.Generator
    ) -> dict[str, Tensor]:
        """All entries of a G-buffer, premultiplied, each (P, 3): "radiance" and the parts of :class:`PixelRadiance`.

        The samples of a pixel are one lattice, dealt out evenly to as few passes of at most PASS_SAMPLES as will do.
        """
        parts = ["diffuse", "specular", "albedo"] + ["mirrored"] * (self.interreflection is not None)
        values = {name: torch.zeros(len(gbuffer.pixel), 3, device=gbuffer.face.device) for name in parts}
        every = torch.arange(len(gbuffer.pixel), device=gbuffer.face.device)
        passes = max(1, min(-(-samples // PASS_SAMPLES), samples // (2 * gbuffer.subsamples)))  # a pass takes two a point or more
        indirect = self._bounce(gbuffer, material, light)
        for chunk in every.split(CHUNK) if len(every) else ():
            padded = torch.cat([chunk, chunk.new_full((CHUNK - len(chunk),), -1)])
            rotation = random_rotation(padded, generator)
            for part in range(passes):
                each = round(samples / passes)
                rendered = self._render(gbuffer, padded, material, light, indirect, each, rotation, part, passes)
                for name in parts:
                    values[name][chunk] += getattr(rendered, name)[: len(chunk)] / passes
        values["radiance"] = sum((values[name] for name in parts if name != "albedo"), torch.zeros(()))
        return values


def random_rotation(pixels: Tensor, generator: torch.Generator) -> Tensor:
    """Cranley-Patterson rotations of the lattices by light and by BRDF of (P,) pixels: (2, P, 3) float64."""
    return torch.rand(2, len(pixels), 3, generator=generator, dtype=torch.float64, device=pixels.device)


def texture_images(surface: SurfaceInterpolator, gbuffer: GBuffer, texture: Tensor) -> Tensor:
    """Premultiplied box-filtered pictures (V, H, W, C) of a texture (T, T, C) mapped onto the surface."""
    return gbuffer.images(surface.averaged(gbuffer.face, gbuffer.barycentric, texture))


def samples_taken(samples: int, points: int) -> int:
    """How many of ``samples`` directions a pixel of ``points`` points takes: each point as many of the light as of the BRDF."""
    return 2 * points * max(1, round(samples / (2 * points)))
