"""The forward check: ground truth through our renderer against Cycles, and where the gap comes from.

    python -m benchmarks.forward_check hat ship console figurine

For each scene, PSNR (sRGB, inside the mask, mean over images) of our render with the true textures and the true light:
against the full Cycles renders, with indirect light, under a coat that takes its share of the diffuse light, and without the
one, the other and both; and against the direct-only Cycles renders of a few test views, which isolate the
rest. Every following column takes one cause away or adds it: the difference between the BRDFs (the coat, and the specular
part alone), the pixel footprint (G-buffer points a pixel), and the light's resolution.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from benchmarks.stage import true_material
from ia_bench.common.arguments import at_least
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import OK, complain
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import SampledLight
from ia_bench.readers.native import NativeReader
from ia_bench.render.stage import Stage
from ia_bench.runs.config import SceneConfig, resolve_scene_folder
from ia_bench.scenes.exr import read_exr
from ia_bench.scenes.images import straight
from ia_bench.scenes.scene import Scene, View
from ia_bench.scores.comparison import encode
from ia_bench.scores.metrics import Compared, psnr

SAMPLES = 1024  # per pixel: noise must not be a cause
LIGHT_ROWS = (64, 128)
BOUNCES = 4


@dataclass(frozen=True)
class ForwardCheck:
    """PSNR in dB of one scene, by column of the report; ``ratio`` is mean radiance, ours over Cycles (direct only)."""

    scene: str
    psnr: dict[str, float]
    ratio: float


def check_scene(folder: Path, *, samples: int = SAMPLES) -> ForwardCheck:
    """Run the check on a scene folder that ships truth and direct-only renders (direct/test/*.exr)."""
    scene = NativeReader(folder).read(truth=True)
    direct = {path.stem: read_exr(path, 4)[..., :3] for path in sorted((folder / "direct" / "test").glob("*.exr"))}
    views = [view for view in scene.test if view.name in direct]
    reference = [direct[view.name] for view in views]
    full = [view.image for view in views]
    stage = _Truth(scene, samples)

    ours = stage.render(views)
    added = stage.render(views, coat="added")
    gaps = {
        "full": _psnr(stage.render(views, bounces=BOUNCES)["radiance"], full, views),
        "full, 16 points a pixel": _psnr(stage.render(views, side=4, bounces=BOUNCES)["radiance"], full, views),
        "full, coat added": _psnr(stage.render(views, coat="added", bounces=BOUNCES)["radiance"], full, views),
        "full, without indirect light": _psnr(ours["radiance"], full, views),
        "full, without both": _psnr(added["radiance"], full, views),
        "direct": _psnr(ours["radiance"], reference, views),
        "direct, coat added": _psnr(added["radiance"], reference, views),
        "specular part": _psnr(ours["specular"], [_specular(scene, view) for view in views], views),
        "1 point a pixel": _psnr(stage.render(views, side=1)["radiance"], reference, views),
        "16 points a pixel": _psnr(stage.render(views, side=4)["radiance"], reference, views),
    }
    for rows in LIGHT_ROWS:
        coarse = stage.render(views, light_rows=rows)
        gaps[f"light of {rows} rows"] = _psnr(coarse["radiance"], reference, views)
    masks = [view.mask > 0.5 for view in views]
    brightness = [
        np.concatenate([image[mask] for image, mask in zip(images, masks, strict=True)]).mean()
        for images in (list(ours["radiance"]), reference)
    ]
    return ForwardCheck(scene.name, gaps, float(brightness[0] / brightness[1]))


class _Truth:
    """The true material and light of a scene, ready to be rendered in several ways."""

    def __init__(self, scene: Scene, samples: int) -> None:
        assert scene.truth is not None
        if scene.truth.albedo is None or scene.truth.roughness is None:
            raise InputError(f"{scene.source}: the forward check needs the true textures")
        self._stage = Stage(scene.expect_mesh(), torch.device("cpu"))
        self._light = torch.from_numpy(scene.truth.lights["train"])
        self._material = true_material(scene.truth)
        self._samples = samples

    def render(
        self, views: list[View], *, side: int = 2, light_rows: int | None = None, coat: str = "layered", bounces: int = 0
    ) -> dict[str, np.ndarray]:
        """Images (V, H, W, 3) of "radiance" and its parts; ``bounces``: none or those of :data:`BOUNCES`."""
        gbuffer = self._stage.gbuffer([view.camera for view in views], side)
        radiance = self._light if light_rows is None else LatLongEnvironment(self._light).latlong(light_rows)
        renderer = self._stage.renderer(bounces=bounces, coat=coat)
        generator = torch.Generator().manual_seed(0)
        light = SampledLight.of(radiance)
        images = renderer.render_images(gbuffer, self._material, light, self._samples, generator)
        return {name: image.numpy() for name, image in images.items()}


def _specular(scene: Scene, view: View) -> np.ndarray:
    if view.specular is None:
        raise InputError(f"{scene.source}: test view {view.name} has no true specular shading")
    return view.specular


def _psnr(rendered: np.ndarray, reference: list[np.ndarray], views: list[View]) -> float:
    values = []
    for ours, theirs, view in zip(rendered, reference, views, strict=True):
        mask = view.mask > 0.5
        pair = (encode(straight(one, view.mask), "srgb", mask)[0] for one in (ours, theirs))
        values.append(psnr(Compared.of_object(*pair, mask)))
    return float(np.mean(values))


def main() -> int:
    """Print one Markdown row per scene."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", help="names of shipped scenes, or scene folders")
    parser.add_argument("--samples", type=at_least(1), default=SAMPLES, help="samples per pixel")
    arguments = parser.parse_args()
    header: list[str] | None = None
    for name in arguments.scenes:
        shipped = SceneConfig(name=name, path=name if Path(name).is_dir() else None)
        try:
            folder = resolve_scene_folder(shipped)
            assert folder is not None
            result = check_scene(folder, samples=arguments.samples)
        except InputError as error:
            return complain(str(error))
        if header is None:
            header = ["scene", *result.psnr, "mean radiance, ours / Cycles"]
            print("| " + " | ".join(header) + " |\n|" + " :--- |" * len(header))
        cells = [result.scene, *(f"{value:.1f}" for value in result.psnr.values()), f"{result.ratio:.3f}"]
        print("| " + " | ".join(cells) + " |", flush=True)
    return OK


if __name__ == "__main__":
    sys.exit(main())
