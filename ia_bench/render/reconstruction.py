"""What a method recovered, as everything after it sees it: pictures of maps, renders, and assets where there are some."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from torch import Tensor

from ia_bench.light.environment import Environment, LatLongEnvironment
from ia_bench.light.latlong import SampledLight
from ia_bench.material.brdf import MIN_ROUGHNESS
from ia_bench.material.textures import Material
from ia_bench.render.light_rays import LightRays
from ia_bench.render.renderer import CHUNK, PASS_SAMPLES, BrdfRayCache, texture_images
from ia_bench.render.settings import REFERENCE, REFERENCE_ATLAS, REFERENCE_BOUNCES, REFERENCE_LIGHT_ROWS
from ia_bench.render.stage import Stage, camera_key
from ia_bench.scenes.images import Images
from ia_bench.scenes.scene import Camera, Mesh
from ia_bench.scenes.turning import TurningLight


@dataclass(frozen=True)
class Assets:
    """Textures and light that any renderer can take: numpy arrays, linear.

    Attributes:
        mesh: The triangles, with the texture coordinates that the textures belong to.
        albedo: (T, T, 3) in [0, 1], and what another program has beyond.
        roughness: (T', T') in [0, 1], perceptual.
        metallic: (T'', T''), None for a dielectric.
        light: (H, W, 3) lat-long radiance, None where no light was recovered.
        assumed: Names of textures that nobody has recovered: they are there for the sake of renders alone, and are not scored.
    """

    mesh: Mesh
    albedo: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray | None = None
    light: np.ndarray | None = None
    assumed: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Quality:
    """How finely a render is drawn.

    Attributes:
        points: Along a side of a pixel, whose mean is the pixel.
        samples: Directions of light a pixel, for a renderer that draws any.
        seed: The seed of everything random in it.
    """

    points: int
    samples: int
    seed: int = 0


@runtime_checkable
class Reconstruction(Protocol):
    """What a method recovered of an object: all that a score, a picture or an export of it is made from."""

    @property
    def renderer(self) -> str:
        """The name of what draws it, for example "split sum"; :data:`REFERENCE` is the one that all methods are compared by."""
        ...

    @property
    def environment(self) -> Environment | None:
        """The light that was recovered, None where there is none."""
        ...

    def maps(self, cameras: Sequence[Camera], names: Collection[str], *, points: int) -> dict[str, Images]:
        """Linear pictures of "albedo" (H, W, 3), "roughness" (H, W) and "metallic" (H, W); what was not recovered is left out.

        ``points``: along a side of a pixel, whose mean is the pixel.
        """
        ...

    def render(
        self, cameras: Sequence[Camera], *, light: Environment | None, albedo_scale: Tensor | None, quality: Quality
    ) -> Images | None:
        """Linear radiance of every view; None where the method cannot render that.

        Under novel lights the reference renderer then draws what it exports, if it exports anything.

        Args:
            cameras: The views; they may differ in size.
            light: The light to render under, None for the recovered one.
            albedo_scale: (3,) factors of the linear albedo, None for the albedo as it was recovered.
            quality: How finely.
        """
        ...

    def assets(self) -> Assets | None:
        """Textures and light as files hold them; None for what is no texture."""
        ...


ADDED = "coat added"
"""How the name of a renderer says that it adds both lobes."""


class TexturedReconstruction:
    """Textures over a mesh and a lat-long light, drawn by the reference renderer whatever renderer they were fitted with.

    The reference renderer traces every shadow, follows REFERENCE_BOUNCES reflections and lays the coat over the diffuse lobe. What
    is smoother than MIN_ROUGHNESS is drawn with that, for float32 resolves no narrower lobe, and counted (:meth:`counts`); maps and
    assets keep it as it is.
    With ``coat`` "added", the paper's sum of both lobes, or other ``bounces``, it is another renderer and goes by another name.
    """

    def __init__(
        self,
        stage: Stage,
        material: Material,
        light: Tensor | None,
        *,
        coat: str = "layered",
        bounces: int = REFERENCE_BOUNCES,
        assumed: frozenset[str] = frozenset(),
        turning: TurningLight | None = None,
    ) -> None:
        """``light`` (H, W, 3) radiance, None where none was recovered; all tensors on the stage's device.

        ``turning``: how that light turns with the camera; a light that :meth:`render` is given does not.
        Maps of what is ``assumed`` are left out. What is drawn is drawn on :attr:`Stage.apart`, so that the stage itself counts the
        rays and points of a fit alone.
        """
        self.material = material
        self.environment = None if light is None else LatLongEnvironment(light, turning=turning)
        unlike = {ADDED: coat == "added", f"{bounces} bounces": bounces != REFERENCE_BOUNCES}
        self.renderer = ", ".join([REFERENCE, *(name for name, it_is in unlike.items() if it_is)])
        self._stage, self._coat, self._bounces, self._assumed = stage.apart, coat, bounces, assumed
        self._last: tuple[object, BrdfRayCache] | None = None

    @property
    def device(self) -> torch.device:
        """Where it draws."""
        return self._stage.device

    @property
    def mesh(self) -> Mesh:
        """What the textures lie on."""
        return self._stage.mesh

    @classmethod
    def of(cls, assets: Assets, stage: Stage, turning: TurningLight | None = None, coat: str = "layered") -> TexturedReconstruction:
        """What assets hold, on a stage of their mesh; ``turning``: how their light does."""

        def texture(image: np.ndarray) -> Tensor:
            return torch.tensor(np.atleast_3d(image)).float().to(stage.device)  # a copy: some images cannot be written to

        metallic = None if assets.metallic is None else texture(assets.metallic)
        light = None if assets.light is None else texture(assets.light)
        material = Material(texture(assets.albedo), texture(assets.roughness), metallic)
        return cls(stage, material, light, coat=coat, assumed=assets.assumed, turning=turning)

    def maps(self, cameras: Sequence[Camera], names: Collection[str], *, points: int) -> dict[str, Images]:
        """See :meth:`Reconstruction.maps`."""
        recovered = [name for name in names if name not in self._assumed]
        found = {name: texture for name in recovered if (texture := getattr(self.material, name)) is not None}
        pictures: dict[str, list[np.ndarray]] = {name: [] for name in found}
        coverage: list[np.ndarray] = []
        for gbuffer in self._stage.gbuffers(cameras, points):
            coverage += _arrays(gbuffer.coverage())
            for name, texture in found.items():
                images = texture_images(self._stage.surface, gbuffer, texture)
                pictures[name] += _arrays(images if images.shape[-1] == 3 else images[..., 0])
        return {name: Images(tuple(images), tuple(coverage)) for name, images in pictures.items()}

    def render(
        self, cameras: Sequence[Camera], *, light: Environment | None, albedo_scale: Tensor | None, quality: Quality
    ) -> Images | None:
        """See :meth:`Reconstruction.render`."""
        chosen = self.environment if light is None else light
        if chosen is None:
            return None
        material, device = replace(self.material, roughness=self.material.roughness.clamp_min(MIN_ROUGHNESS)), self._stage.device
        if albedo_scale is not None:
            material = replace(material, albedo=material.albedo * albedo_scale.to(material.albedo))
        texels = chosen.texels if isinstance(chosen, LatLongEnvironment) else chosen.latlong(REFERENCE_LIGHT_ROWS)
        turning = chosen.turning if isinstance(chosen, LatLongEnvironment) else None
        sampled = SampledLight.of(texels.to(device), turning=turning)
        renderer = self._stage.renderer(shadows="traced", bounces=self._bounces, coat=self._coat, atlas_size=REFERENCE_ATLAS)
        light_rays = self._light_rays_of(cameras, quality, chosen)
        renderer = renderer.keeping_rays(self._rays_of(cameras, quality, turning), light_rays)
        generator = torch.Generator(device=device).manual_seed(quality.seed)
        images, coverage = [], []
        for gbuffer in self._stage.gbuffers(cameras, quality.points):
            images += _arrays(renderer.render_images(gbuffer, material, sampled, quality.samples, generator)["radiance"])
            coverage += _arrays(gbuffer.coverage())
        if light_rays is not None:
            light_rays.end()
        return Images(tuple(images), tuple(coverage))

    def _light_rays_of(self, cameras: Sequence[Camera], quality: Quality, light: Environment) -> LightRays | None:
        """What the cache knows of this picture; None for a light that is no scene's."""
        if not isinstance(light, LatLongEnvironment) or not light.name:
            return None
        picture = [camera_key(camera) for camera in cameras], quality, CHUNK, PASS_SAMPLES
        return LightRays(self.mesh, light.texels, picture, self.device)

    def _rays_of(self, cameras: Sequence[Camera], quality: Quality, turning: TurningLight | None) -> BrdfRayCache:
        """What the last picture's directions by the BRDF met, if it was the same under another light."""
        roughness = self.material.roughness
        picture = [camera_key(camera) for camera in cameras], quality, turning, id(roughness), roughness._version
        if self._last is None or self._last[0] != picture:
            self._last = picture, BrdfRayCache()
        self._last[1].begin()
        return self._last[1]

    def counts(self) -> dict[str, int]:
        """How many texels of the roughness there are, and how many of them are drawn rougher than they are."""
        roughness = self.material.roughness
        return {"texels": roughness.numel(), "roughness_raised": int((roughness < MIN_ROUGHNESS).sum())}

    def assets(self) -> Assets:
        """See :meth:`Reconstruction.assets`."""
        metallic = self.material.metallic
        return Assets(
            mesh=self.mesh,
            albedo=self.material.albedo.cpu().numpy(),
            roughness=self.material.roughness[..., 0].cpu().numpy(),
            metallic=None if metallic is None else metallic[..., 0].cpu().numpy(),
            light=None if self.environment is None else self.environment.texels.cpu().numpy(),
            assumed=self._assumed,
        )


def _arrays(images: Tensor) -> list[np.ndarray]:
    return list(images.cpu().numpy())
