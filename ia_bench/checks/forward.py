"""The forward check: ground truth through our renderer against Cycles, and where the gap comes from.

    python -m ia_bench.checks.forward hat ship console figurine

For each scene, PSNR (sRGB, inside the mask, mean over images) of our render with the true textures and the true light:
against the full Cycles renders, which have indirect light that ours has not, and against the direct-only Cycles renders
of a few test views, which isolate the rest. Every following column takes one cause away or adds it: the difference
between the BRDFs (measured on the diffuse and the specular part apart, and by letting the coat take its share of the
diffuse light, as the Principled BSDF does), the pixel footprint (G-buffer points a pixel), and the light's resolution.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ia_bench.config import SceneConfig, resolve_scene_folder
from ia_bench.errors import InputError
from ia_bench.light.latlong import resize_light
from ia_bench.material.brdf import MIN_ROUGHNESS, sample_visible_ggx, specular_brdf_cosine, visible_ggx_pdf
from ia_bench.material.textures import Material, fetch
from ia_bench.render.gbuffer import GBuffer, SurfaceInterpolator, trace_gbuffer
from ia_bench.render.rays import RayCaster, make_rays
from ia_bench.render.renderer import Light, Renderer
from ia_bench.render.visibility import TracedShadows
from ia_bench.scenes.exr import read_exr
from ia_bench.scenes.native import load_scene
from ia_bench.scenes.scene import Scene, View
from ia_bench.scores.metrics import encode, psnr

SAMPLES = 1024  # per pixel: noise must not be a cause
LIGHT_ROWS = (64, 128)
COAT_GRID = 32


@dataclass(frozen=True)
class ForwardCheck:
    """PSNR in dB of one scene, by column of the report; ``ratio`` is mean radiance, ours over Cycles (direct only)."""

    scene: str
    psnr: dict[str, float]
    ratio: float


def check_scene(folder: Path, *, samples: int = SAMPLES) -> ForwardCheck:
    """Run the check on a scene folder that ships truth and direct-only renders (direct/test/*.exr)."""
    scene = load_scene(folder, truth=True)
    direct = {path.stem: read_exr(path, 4)[..., :3] for path in sorted((folder / "direct" / "test").glob("*.exr"))}
    views = [view for view in scene.test if view.name in direct]
    reference = [direct[view.name] for view in views]
    full = [view.image for view in views]
    stage = _Stage(scene, samples)

    ours = stage.render(views, side=2)
    gaps = {
        "full": _psnr(ours["radiance"], full, views),
        "direct": _psnr(ours["radiance"], reference, views),
        "direct, coat takes its share": _psnr(ours["coated"], reference, views),
        "specular part": _psnr(ours["specular"], [_specular(scene, view) for view in views], views),
        "1 point a pixel": _psnr(stage.render(views, side=1)["radiance"], reference, views),
        "16 points a pixel": _psnr(stage.render(views, side=4)["radiance"], reference, views),
    }
    for rows in LIGHT_ROWS:
        coarse = stage.render(views, side=2, light_rows=rows)
        gaps[f"light of {rows} rows"] = _psnr(coarse["radiance"], reference, views)
    masks = [view.mask > 0.5 for view in views]
    brightness = [
        np.concatenate([image[mask] for image, mask in zip(images, masks, strict=True)]).mean()
        for images in (list(ours["radiance"]), reference)
    ]
    return ForwardCheck(scene.name, gaps, float(brightness[0] / brightness[1]))


class _Stage:
    """The true material and light of a scene, ready to be rendered in several ways."""

    def __init__(self, scene: Scene, samples: int) -> None:
        assert scene.truth is not None
        albedo, roughness = scene.truth.albedo, scene.truth.roughness
        if albedo is None or roughness is None:
            raise InputError(f"{scene.folder}: the forward check needs the true textures")
        device = torch.device("cpu")
        self._rays: RayCaster = make_rays(scene.mesh, device)
        self._surface = SurfaceInterpolator(scene.mesh, device)
        shadows = TracedShadows(self._rays, self._surface.offset)
        self._renderer = Renderer(self._surface, shadows, shading="eager")
        self._light = scene.truth.lights["train"]
        rough = torch.from_numpy(roughness)[..., None].clamp(MIN_ROUGHNESS, 1)
        self._material = Material(torch.from_numpy(albedo).float(), rough)
        self._samples = samples
        self._coat = coat_reflectance(COAT_GRID)

    def render(self, views: list[View], *, side: int, light_rows: int | None = None) -> dict[str, np.ndarray]:
        """Images (V, H, W, 3) of "radiance", "specular", and "coated" (diffuse light less what the coat reflects)."""
        gbuffer = trace_gbuffer([view.camera for view in views], self._rays, side, torch.device("cpu"))
        radiance = self._light if light_rows is None else resize_light(self._light, light_rows)
        generator = torch.Generator().manual_seed(0)
        light = Light.of(torch.from_numpy(radiance))
        images = self._renderer.render_images(gbuffer, self._material, light, self._samples, generator)
        passed = 1 - self._coat_image(gbuffer)
        coated = images["diffuse"] * passed[..., None] + images["specular"]
        return {name: image.numpy() for name, image in {**images, "coated": coated}.items()}

    def _coat_image(self, gbuffer: GBuffer) -> Tensor:
        """Share of light that the coat reflects toward the camera, averaged over each pixel's points: (V, H, W)."""
        hit = gbuffer.face >= 0
        camera = gbuffer.origin[gbuffer.pixel // (gbuffer.shape[1] * gbuffer.shape[2])][:, None].expand(*hit.shape, 3)
        points = self._surface(gbuffer.face[hit].long(), gbuffer.barycentric[hit], camera[hit])
        roughness = fetch(self._material.roughness, points.uv)[..., 0]
        cosine = (points.normal * points.view).sum(-1)
        cell = [(values * COAT_GRID).long().clamp(0, COAT_GRID - 1) for values in (roughness, cosine)]
        share = torch.zeros(hit.shape)
        share[hit] = self._coat[cell[0], cell[1]]
        image = torch.zeros(gbuffer.shape).flatten()
        image[gbuffer.pixel] = share.sum(1) / hit.sum(1).clamp_min(1)
        return image.reshape(gbuffer.shape)


def coat_reflectance(size: int, samples: int = 4096) -> Tensor:
    """Directional albedo of the specular lobe on a (roughness, cosine) grid of cell centres in [0, 1]: (size, size)."""
    centres = (torch.arange(size) + 0.5) / size
    roughness, cosine = (grid[..., None, None] for grid in torch.meshgrid(centres, centres, indexing="ij"))
    normal = torch.tensor([0.0, 0.0, 1.0]).expand(size, size, samples, 3)
    view = torch.cat([torch.sqrt(1 - cosine * cosine), torch.zeros_like(cosine), cosine], -1).expand(normal.shape)
    u = torch.rand(size, size, samples, 2, generator=torch.Generator().manual_seed(0))
    rough = roughness.clamp_min(MIN_ROUGHNESS).expand(size, size, samples, 1)
    incident = sample_visible_ggx(normal, view, rough, u)
    density = visible_ggx_pdf(normal, view, incident, rough)
    value = specular_brdf_cosine(normal, view, incident, rough) / density.clamp_min(1e-12)
    return torch.where(density > 0, value, torch.zeros_like(value)).mean(2)[..., 0]


def _specular(scene: Scene, view: View) -> np.ndarray:
    if view.specular is None:
        raise InputError(f"{scene.folder}: test view {view.name} has no true specular shading")
    return view.specular


def _psnr(rendered: np.ndarray, reference: list[np.ndarray], views: list[View]) -> float:
    values = []
    for ours, theirs, view in zip(rendered, reference, views, strict=True):
        mask, share = view.mask > 0.5, np.maximum(view.mask, 1e-6)[..., None]
        values.append(psnr(encode(ours / share, "srgb", mask)[0], encode(theirs / share, "srgb", mask)[0], mask))
    return float(np.mean(values))


def main() -> None:
    """Print one Markdown row per scene."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", help="names of shipped scenes, or scene folders")
    parser.add_argument("--samples", type=int, default=SAMPLES, help="samples per pixel")
    arguments = parser.parse_args()
    header: list[str] | None = None
    for name in arguments.scenes:
        shipped = SceneConfig(name=name, path=name if Path(name).is_dir() else None)
        folder = resolve_scene_folder(shipped)
        assert folder is not None
        result = check_scene(folder, samples=arguments.samples)
        if header is None:
            header = ["scene", *result.psnr, "mean radiance, ours / Cycles"]
            print("| " + " | ".join(header) + " |\n|" + " :--- |" * len(header))
        cells = [result.scene, *(f"{value:.1f}" for value in result.psnr.values()), f"{result.ratio:.3f}"]
        print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
