"""Reader of TensoIR-Synthetic (Jin et al., CVPR 2023): folders train_NNN and test_NNN (:mod:`ia_bench.readers.view_folders`).

Training and held-out photographs are ``rgba_sunset_000.png``: a light and the angle by which it was turned. Held-out views are
also there under novel lights, ``rgba_bridge.png`` and others, whose maps are a download of their own: ``lights``.
"""

from __future__ import annotations

import re
from pathlib import Path

from ia_bench.common.errors import InputError
from ia_bench.readers.intake import Intake, Unwrapping
from ia_bench.readers.lights import lights_below
from ia_bench.readers.view_folders import ViewFolder, view_folders
from ia_bench.scenes.scene import Scene, Truth, View

TURNED = re.compile(r"_\d{3}$")  # the name of a light that was turned by so many degrees


class TensoirReader:
    """Reads the folder of one object; options that all readers share are those of :class:`ia_bench.readers.intake.Intake`.

    ``lights``: the folder of the environment maps (LIGHT.hdr or .exr); ``light`` and ``rotation``: what the training photographs
    were taken under.
    """

    def __init__(
        self,
        path: Path | None,
        *,
        mesh: str | None = None,
        uv: Unwrapping = "mesh",
        shrink: int = 1,
        held_out: int | None = None,
        lights: str | None = None,
        light: str = "sunset",
        rotation: str = "000",
    ) -> None:
        self._intake = Intake.of("tensoir", path, mesh=mesh, uv=uv, shrink=shrink, held_out=held_out)
        self._lights, self._light, self._rotation = lights, light, rotation

    def read(self, truth: bool) -> Scene:
        """The scene; albedo and normals of held-out views, and maps of lights, only with ``truth``. Raises InputError."""
        intake, notes = self._intake, list[str]()
        folders = {split: view_folders(intake.folder, split) for split in ("train", "test")}
        if not folders["train"]:
            raise InputError(f"{intake.folder}: expected folders train_000, train_001, ... with metadata.json, found none")
        train = [intake.view(self._photograph(folder, notes)) for folder in folders["train"]]
        test, novel = list[View](), list[View]()
        for folder in intake.kept(folders["test"]):
            view = self._photograph(folder, notes)
            test.append(intake.view(folder.with_truth(view) if truth else view))
            novel.append(intake.view(view))
            novel += [intake.view(folder.view(path, notes, light)) for light, path in self._novel(folder).items()]
        known = self._truth(novel, notes) if truth else None
        return intake.scene(train=train, test=test, novel=novel, truth=known, notes=notes)

    def _photograph(self, folder: ViewFolder, notes: list[str]) -> View:
        return folder.view(folder.picture(f"rgba_{self._light}_{self._rotation}.png", f"rgba_{self._light}.png"), notes)

    def _novel(self, folder: ViewFolder) -> dict[str, Path]:
        return {light: path for light, path in folder.lights().items() if light != self._light and not TURNED.search(light)}

    def _truth(self, novel: list[View], notes: list[str]) -> Truth:
        known = [self._light] if self._rotation == "000" else []  # a turned map is not among the files
        found, said = lights_below("reader.options.lights", self._lights, [*known, *sorted({v.light for v in novel} - {"train"})])
        notes += said
        return Truth({"train" if light == self._light else light: radiance for light, radiance in found.items()})
