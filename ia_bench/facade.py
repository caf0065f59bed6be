"""The front door for Python, ``import ia_bench as ib``: a scene, a fit of it, its scores, and a table of several.

Everything here goes the way of ``ia-bench run``: settings have the same names, results lie in the same folders, numbers are equal.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias, get_args

import numpy as np
import pandas as pd
import torch
from PIL import Image

from ia_bench.capture.capture import captured
from ia_bench.common.calls import expect_kind, expect_whole, path_of
from ia_bench.common.errors import InputError, unknown
from ia_bench.common.exit_codes import log
from ia_bench.common.paths import make_writable
from ia_bench.common.progress import Progress
from ia_bench.common.registry import process_state_kept
from ia_bench.common.settings import flat
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.readers.contract import check_camera
from ia_bench.render.reconstruction import Quality, TexturedReconstruction
from ia_bench.render.stage import Stage
from ia_bench.report.collect import CellKey, collect
from ia_bench.runs.cells import folders_with_cells
from ia_bench.runs.composition import compose, written
from ia_bench.runs.execute import execute
from ia_bench.runs.identity import from_anywhere
from ia_bench.runs.recovered import Recovered
from ia_bench.runs.relighting import Background, draw, frames_of, light_called
from ia_bench.runs.scene import read_scene
from ia_bench.scenes.exr import read_exr
from ia_bench.scenes.scene import Camera, Scene
from ia_bench.scores.metrics import MEASURED
from ia_bench.scores.scorer import Scorer

Light: TypeAlias = str | Path | np.ndarray
Scored: TypeAlias = dict[str, dict[str, float | None]]
"""Component -> metric -> mean, as metrics.json has them."""
SHOWN = ("row", "scene", "seed", "protocol", "capture", *(metric.column for metric in MEASURED), "seconds", "problem")
"""Columns of :func:`table`, in their order."""


@dataclass(frozen=True)
class LoadedScene(Scene):
    """A scene as :func:`load` has read it.

    Attributes:
        settings: What makes a run read it again; empty for one that was made of another by ``dataclasses.replace``, and is in no
            file.
    """

    settings: tuple[str, ...] = field(default=(), init=False, compare=False)

    def __repr__(self) -> str:
        """What it is, in a line."""
        counts = f"{len(self.train)} training, {len(self.test)} test and {len(self.novel)} novel views"
        return f"<scene {self.name}: {counts}, from {self.source}>"


def load(scene: str | Path, *, reader: str = "native", **settings: Any) -> LoadedScene:  # noqa: ANN401 (values of settings)
    """Read a scene with its truth: ``load("hat")``, ``load("captures/mug", reader="nerfstudio")``.

    Args:
        scene: The name of a shipped scene, or a folder. A word alone is a name for the native reader, and a folder for any other.
        reader: The format of the folder's files: a reader's name, or ``"module:Class"``.
        **settings: Other settings of the scene, for example ``**{"reader.options.every": 8}``.

    Raises:
        InputError: There is no such scene, or something is wrong with it.
    """
    expect_kind(str, "a reader's name", reader=reader)
    folder = path_of("scene", scene)
    is_name = reader == "native" and isinstance(scene, str) and Path(scene).name == scene != ".."
    place = {"scene": scene} if is_name else {"scene.path": folder.resolve()}
    given = tuple(_overrides(from_anywhere({**place, "reader": reader, **settings})))
    with process_state_kept():
        config = compose(given)
        found = read_scene(config.scene, config.reader, truth=True)
    for line in found.notes:
        log.info("%s: %s", found.name, line)
    loaded = LoadedScene(**{part.name: getattr(found, part.name) for part in fields(Scene)})
    object.__setattr__(loaded, "settings", given)
    return loaded


class Fit(Recovered):
    """What was recovered of a scene: a finished run, which may as well be one of the command line: ``Fit("runs/hat/none-1a2b")``.

    ``repr(fit)`` is its scores.
    """

    def __init__(self, folder: str | Path) -> None:
        """Raises InputError for a folder that holds no finished run."""
        super().__init__(path_of("folder", folder))

    def __repr__(self) -> str:
        """The scores, as the command prints them."""
        return self.record.summary()

    @property
    def metrics(self) -> Scored:
        """Component -> metric -> mean, None where the scene has no truth of it; ``record.reasons`` says why."""
        return self.record.metrics

    @cached_property
    def albedo(self) -> np.ndarray | None:
        """The texture (T, T, 3) in [0, 1], linear. None, as the next three, where the method recovers none."""
        return self._map("albedo", 3)

    @cached_property
    def roughness(self) -> np.ndarray | None:
        """The texture (T, T) in [0, 1], perceptual."""
        return self._map("roughness", 1)

    @cached_property
    def metallic(self) -> np.ndarray | None:
        """The texture (T, T) in [0, 1]."""
        return self._map("metallic", 1)

    @cached_property
    def light(self) -> np.ndarray | None:
        """The light as a lat-long map (H, W, 3) of linear radiance."""
        return self._map("light", 3)

    @cached_property
    def scene(self) -> Scene:
        """The scene that was fitted, as the run's capture left it, with its truth. Raises InputError if its files have changed."""
        return self.read_scene()

    @cached_property
    def _textured(self) -> TexturedReconstruction:
        """What was recovered, for the reference renderer, where the run was made. Raises InputError where it has no textures."""
        return self.reconstruction(Stage(self.scene.expect_mesh(), self.device))

    def render(self, camera: Camera, light: Light | None = None, *, samples: int = 64) -> np.ndarray:
        """Linear radiance (H, W, 3) that a camera sees, premultiplied by coverage, by the reference renderer.

        Args:
            camera: For example ``scene.test[0].camera``.
            light: None for the recovered one; else the name of a light of the scene, a lat-long map as a file (EXR, HDR), or as
                an array (H, 2 H, 3) of linear radiance.
            samples: Directions of light a pixel.

        Raises:
            InputError: There is no such light, none was recovered, or an argument is none.
        """
        expect_whole(1, samples=samples)
        expect_kind(Camera, "a Camera", camera=camera)
        check_camera("camera", camera)
        found, texels = self._textured, None if light is None else self._texels(light)
        environment = None if texels is None else LatLongEnvironment(torch.from_numpy(texels).to(found.device))
        with process_state_kept():
            drawn = found.render([camera], light=environment, albedo_scale=None, quality=Quality(2, samples))
        if drawn is None:
            raise InputError(f"light: expected one, since method={self.config.method.name} recovers none, found None")
        return drawn.images[0]

    def relight(
        self, light: Light, view: str = "still", *, size: int = 512, samples: int = 64, background: Background = "transparent"
    ) -> Image.Image:
        """The object under another light as a picture, exposed for the object; ``ia-bench relight`` also makes animations.

        ``light`` and ``samples`` as in :meth:`render`; ``view``: the name of a view of the scene, as "test/0001", or "still",
        from the side and above; ``size``: height in pixels; ``background``: "transparent", "light" or "white".
        """
        expect_whole(1, size=size, samples=samples)
        expect_kind(str, "text", view=view, background=background)
        if background not in get_args(Background):
            raise InputError(unknown("background", background, get_args(Background)))
        frames = frames_of(view, 1, self.scene.expect_mesh(), self.scene, size)
        with process_state_kept():
            pictures, _ = draw(self._textured, self._texels(light), frames, background=background, quality=Quality(3, samples))
        return Image.fromarray(np.round(255 * pictures[0]).astype(np.uint8))

    def save(self, path: str | Path) -> Path:
        """Write the object with its textures as a glTF binary, which any viewer opens. Raises InputError for another suffix."""
        path, asset = path_of("path", path), self.folder / "asset.glb"
        if path.suffix.lower() != ".glb":
            raise InputError(f"{path}: expected a name that ends with .glb, found {path.suffix or 'none'}")
        if not self.has("asset.glb"):
            raise InputError(f"{asset}: expected the textures of the run, found none: method={self.config.method.name} leaves none")
        make_writable(path.parent, str(path))
        if not (path.exists() and path.samefile(asset)):
            shutil.copyfile(asset, path)
        return path

    def _map(self, name: str, channels: int) -> np.ndarray | None:
        if not self.has(f"{name}.exr"):
            return None
        image: np.ndarray = read_exr(self.folder / f"{name}.exr", channels)
        return image[..., 0] if channels == 1 else image

    def _texels(self, light: Light) -> np.ndarray:
        if isinstance(light, np.ndarray):
            if light.dtype.kind not in "biuf" or light.ndim != 3 or light.shape[1:] != (2 * len(light), 3) or not light.size:
                raise InputError(f"light: expected an array (H, 2 H, 3) of radiance, found one of {light.shape} {light.dtype}")
            with np.errstate(over="ignore"):
                light = np.asarray(light, np.float32)
            if not (np.isfinite(light).all() and light.min() >= 0):
                raise InputError(f"light: expected finite radiance of 0 and more, found {light.min():.4g} to {light.max():.4g}")
            return light
        return light_called(str(light), self.scene, "light")


def fit(
    scene: LoadedScene,
    prior: str = "none",
    *,
    preset: str = "quick",
    seed: int = 0,
    device: str = "auto",
    progress: bool = True,
    out: str | Path | None = None,
    **settings: Any,  # noqa: ANN401 (values of settings)
) -> Fit:
    """Reconstruct a scene and score it; a fit that was made before is read, one that was interrupted goes on.

    Args:
        scene: What :func:`load` gave.
        prior: A prior's name, or ``"module:Class"``.
        preset: How much work: "smoke", "quick" or "full"; or the paper's settings: "letter", "paper".
        seed: Every random draw depends on it.
        device: "auto", "cpu" or "cuda".
        progress: Whether progress and notes are shown on standard error; if not, notes are logged by the logger ``ia_bench``.
        out: The folder of the results, None for ``runs/SCENE/ROW-HASH`` below the current one.
        **settings: Any other setting of ``ia-bench run``; dots are tables: ``capture={"views": 8}``, ``coupling="kernel"``.

    Raises:
        InputError: A setting or the scene is wrong.
    """
    if not isinstance(scene, LoadedScene) or not scene.settings:
        found = "one that was changed since" if isinstance(scene, LoadedScene) else type(scene).__name__
        raise InputError(f"scene: expected what ib.load has read from files, found {found}")
    own = {
        "prior": prior,
        "preset": preset,
        "seed": seed,
        "device": device,
        **({} if out is None else {"out": path_of("out", out)}),
    }
    with process_state_kept(), Progress(quiet=not progress) as shown:
        _, folder = execute(compose([*scene.settings, *_overrides(own | settings)]), shown)
    return Fit(folder)


def score(found: Fit, scene: LoadedScene | None = None, *, protocol: str | None = None, progress: bool = True) -> Scored:
    """Score what was recovered again: component -> metric -> mean, as :attr:`Fit.metrics`; nothing is written.

    What the textures look like is drawn by the reference renderer, whatever renderer the method had of its own.

    Args:
        found: The fit.
        scene: Whose truth it is compared with, None for its own. Another one needs the same mesh.
        protocol: The name of another protocol than that of the run.
        progress: Whether progress is shown on standard error.
    """
    expect_kind(Fit, "a Fit", found=found)
    expect_kind(Scene | None, "a scene", scene=scene)
    expect_kind(str | None, "a protocol's name", protocol=protocol)
    rules = found.config.protocol if protocol is None else compose([f"protocol={protocol}"]).protocol
    compared = found.scene if scene is None else captured(scene, found.config.capture, log.info)
    with process_state_kept(), Progress(quiet=not progress) as shown:
        return Scorer(compared, rules, found._textured.device).full(found._textured, shown.task).metrics


def table(runs: Sequence[Fit | str | Path]) -> pd.DataFrame:
    """A line per run: row, scene, seed, every score that some run has, seconds, and why a run failed.

    ``runs``: fits, and folders that are searched for runs. Raises InputError for two runs of one row, scene and seed: name a
    row by ``fit(..., row="mine")``.
    """
    if isinstance(runs, str) or not isinstance(runs, Iterable):
        raise InputError(f"runs: expected a list of fits and folders, found {type(runs).__name__}")
    folders: dict[Path, CellKey | None] = {}
    for one in runs:
        found = {one.folder: None} if isinstance(one, Fit) else folders_with_cells([path_of("runs", one)], log.info)
        for folder, cell in found.items():  # a fit may lie in a folder that is searched, too
            folders[folder.resolve()] = cell or folders.get(folder.resolve())
    collection = collect(folders)
    for problem in collection.unreadable:
        log.warning("left out, no record of a run: %s", problem)
    return collection.runs.reindex(columns=list(SHOWN)).dropna(axis=1, how="all")


def _overrides(settings: Mapping[str, Any]) -> list[str]:
    """Settings as on the command line; those of a table are dotted."""
    return [f"{name}={written(value, name)}" for name, value in flat(settings).items() if not isinstance(value, Mapping)]
