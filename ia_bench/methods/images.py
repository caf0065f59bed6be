"""``method=images``: pictures that other software made of the held-out views, scored as they are.

A folder has some of ``albedo/``, ``roughness/``, ``view_synthesis/`` (under the training light) and ``relighting/LIGHT/``. In each
is one picture for every view that is scored by it (:func:`ia_bench.methods.info.held_out`). OpenEXR is linear, and premultiplied
where it has alpha. PNG has straight alpha and an encoding that must be said. A picture without alpha covers all of its view.

Nothing is rescaled but by the protocol: where that aligns albedo, pictures under novel lights are compared as they were drawn.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from ia_bench.common.declared import Declared
from ia_bench.common.errors import InputError, expect_distinct, unknown
from ia_bench.common.files import read_json, shown, user_path
from ia_bench.methods.info import HeldOut, MethodInfo
from ia_bench.scenes.color import srgb_to_linear
from ia_bench.scenes.exr import expect_radiance
from ia_bench.scenes.images import Images
from ia_bench.scenes.photograph import read_stored, unit_alpha

if TYPE_CHECKING:
    from torch import Tensor

    from ia_bench.light.environment import Environment
    from ia_bench.methods.contract import Monitor, Problem, Result
    from ia_bench.render.reconstruction import Assets, Quality
    from ia_bench.scenes.scene import Camera

Encoding = Literal["srgb", "linear"]
OPTION = "method.options."
SUFFIXES = (".exr", ".png")
ORDERS = ("names", "sorted")
"""How pictures may be called; any other order is a file that says it."""
GREY = 1.5 / 255  # by which the channels of a picture of one value may differ


@dataclass(frozen=True, kw_only=True)
class ImagesOptions:
    """What is brought.

    Attributes:
        path: The folder of pictures.
        encoding: The encoding of PNG pictures of colour, "srgb" or "linear"; roughness is always as it is stored.
        albedo_encoding: The same of albedo alone, None for that of all colours.
        order: "names": a picture is called like its view; "sorted": pictures by name are in the order of the views; or a JSON file
            whose "frames" say by their "file_path" what the pictures of the first view, the second one and so on are called.
        declared: What is said of how they were made.
    """

    path: str = ""
    encoding: Encoding | None = None
    albedo_encoding: Encoding | None = None
    order: str = "names"
    declared: Declared = field(default_factory=Declared)


class BroughtImages:
    """Reads pictures when they are scored; nothing is optimised."""

    Options: ClassVar[type] = ImagesOptions
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    info = MethodInfo(uses_prior=False, fits_exposures=True, turns_light=True, brought=True, needs=frozenset())

    def __init__(self, options: ImagesOptions) -> None:
        """Nothing is read yet."""
        self._options = options

    @classmethod
    def files(cls, options: Mapping[str, Any]) -> list[Path]:
        """The folder, and the file that says the order. Raises InputError where one is not there."""
        found = [user_path(f"{OPTION}path", options["path"], folder=True)]
        order = options.get("order", "names")
        return found if order in ORDERS else [*found, user_path(f"{OPTION}order", order)]

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        """Raises InputError for pictures that are missing, of another size, or not what they should be; each is looked at."""
        from ia_bench.methods.contract import Result

        pictures = BroughtPictures(self._options, problem.held_out)
        bar = monitor.task("pictures", sum(len(problem.held_out[folder]) for folder in pictures.paths), 0)
        for folder in pictures.paths:
            for _, camera in problem.held_out[folder]:
                pictures.read(folder, camera)
                bar.advance()
        for folder in sorted(problem.held_out.keys() - pictures.paths.keys()):
            monitor.note(f"{self._options.path}: no folder {folder}, so that is not scored")
        return Result(pictures, declared=self._options.declared)


def _by_number(name: str) -> list[str | int]:
    """What sorts names by the numbers in them: every second part is one."""
    return [int(part) if place % 2 else part for place, part in enumerate(re.split(r"(\d+)", name))]


class BroughtPictures:
    """Pictures in folders, as a :class:`ia_bench.render.reconstruction.Reconstruction`.

    Attributes:
        paths: Folder -> camera, as :func:`ia_bench.render.stage.camera_key` has it -> file.
    """

    environment: Environment | None = None

    def __init__(self, options: ImagesOptions, views: HeldOut) -> None:
        """Finds every picture, and reads none. Raises InputError for one that is missing, and folders of other names."""
        from ia_bench.render.settings import BROUGHT
        from ia_bench.render.stage import camera_key

        self.renderer, self._options = BROUGHT, options
        self._folder = Path(options.path).expanduser()
        there = [path for path in self._folder.iterdir() if path.is_dir() and path.name != "relighting"]
        there += [path for path in self._folder.glob("relighting/*") if path.is_dir()]
        folders = sorted(path.relative_to(self._folder).as_posix() for path in there)
        for name in folders:
            if name not in views:
                raise InputError(f"{self._folder}: {unknown('folder', name, sorted(views))}")
        if not folders:
            raise InputError(f"{self._folder}: expected some of the folders {', '.join(views)}, found none")
        lit = [name for name in views if name.startswith("relighting/")]
        if 0 < len(set(lit) & set(folders)) < len(lit):
            raise InputError(f"{self._folder}: expected every novel light, found no {', '.join(sorted(set(lit) - set(folders)))}")
        self.paths = {
            name: {camera_key(camera): path for (_, camera), path in zip(views[name], self._files(name, views), strict=True)}
            for name in folders
        }
        for name, found in self.paths.items():
            if len(found) < len(views[name]):
                raise InputError(f"{self._folder}: {name}: expected views of different cameras, by which pictures are told apart")

    def _files(self, name: str, views: HeldOut) -> list[Path]:
        """The file of each view. Raises InputError naming those that have none."""
        folder, order = self._folder / name, self._options.order
        there = [path for suffix in SUFFIXES for path in sorted(folder.glob(f"[!.]*{suffix}"))]
        expect_distinct(f"{folder}: expected one picture, .exr or .png, of a name", [path.stem for path in there])
        files = {path.stem: path for path in there}
        wanted = [view for view, _ in views[name]]
        expect_distinct(f"{folder}: expected views of different names", wanted)
        if order == "sorted":
            if (by_number := sorted(files, key=_by_number)) != sorted(files):
                expected = "expected the same order by name as by number, as of 08, 09, 10"
                raise InputError(f"{folder}: {expected}, found {shown(', '.join(by_number))}")
            wanted = sorted(files) + wanted[len(files) :]
        elif order != "names":
            frames = read_json(Path(order).expanduser()).get("frames", [])
            named = [Path(str(frame.get("file_path"))).stem for frame in frames if isinstance(frame, dict)]
            if len(named) != len(wanted):
                raise InputError(f"{order}: frames: expected {len(wanted)}, one for every view of {name}, found {len(named)}")
            wanted = named
        missing = [view for view in wanted if view not in files]
        if missing or len(wanted) != len(views[name]):
            some = ", ".join(missing[:3]) + (f" and {len(missing) - 3} more" if len(missing) > 3 else "")
            found = f"no {some}" if missing else f"{len(wanted)}"
            raise InputError(f"{folder}: expected a picture (.exr, .png) of each of {len(views[name])} views, found {found}")
        return [files[view] for view in wanted]

    def read(self, folder: str, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """A picture (H, W, 3), or (H, W) of roughness, linear and premultiplied, and its coverage (H, W). Raises InputError."""
        from ia_bench.render.stage import camera_key

        path, grey = self.paths[folder][camera_key(camera)], folder == "roughness"
        stored = read_stored(path, grey=grey)
        alpha = unit_alpha(path, stored[..., 3]) if stored.shape[-1] == 4 else np.ones(stored.shape[:2], np.float32)
        image = stored[..., :3]
        if path.suffix == ".png":
            encoding = (self._options.albedo_encoding if folder == "albedo" else None) or self._options.encoding
            if encoding is None and not grey:
                raise InputError(f"{path}: expected {OPTION}encoding=srgb or linear with PNG pictures, found none")
            image = (srgb_to_linear(image) if encoding == "srgb" and not grey else image) * alpha[..., None]
        expect_radiance(path, image)
        if alpha.shape != (camera.height, camera.width):
            height, width = alpha.shape
            raise InputError(f"{path}: expected {camera.width} x {camera.height} pixels like its view, found {width} x {height}")
        if grey:
            if (np.ptp(image, axis=-1) > GREY).any():
                raise InputError(f"{path}: expected one value of roughness a pixel, found colours")
            image = image[..., 0]
            if image.max(initial=0) > 1 + GREY:
                raise InputError(f"{path}: expected roughness from 0 to 1, found {image.max():.4g}")
        return image, alpha

    def _images(self, folder: str, cameras: Sequence[Camera]) -> Images | None:
        if folder not in self.paths:
            return None
        read = [self.read(folder, camera) for camera in cameras]
        return Images(tuple(image for image, _ in read), tuple(coverage for _, coverage in read))

    def maps(self, cameras: Sequence[Camera], names: Collection[str], *, points: int) -> dict[str, Images]:
        """See :meth:`ia_bench.render.reconstruction.Reconstruction.maps`."""
        found = {name: self._images(name, cameras) for name in names}
        return {name: images for name, images in found.items() if images is not None}

    def render(
        self, cameras: Sequence[Camera], *, light: Environment | None, albedo_scale: Tensor | None, quality: Quality
    ) -> Images | None:
        """See :meth:`ia_bench.render.reconstruction.Reconstruction.render`; the light says by its name which pictures."""
        return self._images("view_synthesis" if light is None else f"relighting/{getattr(light, 'name', '')}", cameras)

    def assets(self) -> Assets | None:
        """There are none."""
        return None
