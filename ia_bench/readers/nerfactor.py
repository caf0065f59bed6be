"""Reader of NeRFactor's synthetic scenes (Zhang et al., SIGGRAPH Asia 2021), see :mod:`ia_bench.readers.view_folders`.

Folders are train_NNN, val_NNN and test_NNN. Photographs are ``rgba.png``, under the map that metadata.json calls ``envmap``
*times* ``envmap_inten`` (3); held-out views are also there under novel maps at strength 1, ``rgba_city.png`` and others, and
under single point lights, ``rgba_olat-*.png``, which no environment map stands for and which are left out.
"""

from __future__ import annotations

from pathlib import Path

from ia_bench.common.errors import InputError
from ia_bench.readers.fields import number, text
from ia_bench.readers.intake import Intake, Unwrapping
from ia_bench.readers.lights import lights_below
from ia_bench.readers.view_folders import ViewFolder, view_folders
from ia_bench.scenes.scene import Scene, Truth, View

STRENGTH = 3.0  # of the training light, where metadata.json does not say it
POINT_LIGHT = "olat"


class NerfactorReader:
    """Reads the folder of one object; options that all readers share are those of :class:`ia_bench.readers.intake.Intake`.

    ``lights``: the folder of the environment maps (LIGHT.hdr or .exr).
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
    ) -> None:
        self._intake = Intake.of("nerfactor", path, mesh=mesh, uv=uv, shrink=shrink, held_out=held_out)
        self._lights = lights

    def read(self, truth: bool) -> Scene:
        """The scene; albedo and normals of held-out views, and maps of lights, only with ``truth``. Raises InputError."""
        intake, notes = self._intake, list[str]()
        training = view_folders(intake.folder, "train")
        if not training:
            raise InputError(f"{intake.folder}: expected folders train_000, train_001, ... with metadata.json, found none")
        train = [intake.view(folder.view(folder.picture("rgba.png"), notes)) for folder in training]
        test, novel = list[View](), list[View]()
        held_out = [*view_folders(intake.folder, "val"), *view_folders(intake.folder, "test")]
        for folder in intake.kept([folder for folder in held_out if (folder.folder / "rgba.png").is_file()]):
            view = folder.view(folder.picture("rgba.png"), notes)
            test.append(intake.view(folder.with_truth(view) if truth else view))
            novel.append(intake.view(view))
            lights = {light: path for light, path in folder.lights().items() if not light.startswith(POINT_LIGHT)}
            novel += [intake.view(folder.view(path, notes, light)) for light, path in lights.items()]
        without = sum(not (folder.folder / "rgba.png").is_file() for folder in held_out)
        if without:
            notes.append(f"{without} of {len(held_out)} held-out views have no photograph rgba.png and are left out")
        known = self._truth(training[0], novel, notes) if truth else None
        return intake.scene(train=train, test=test, novel=novel, truth=known, notes=notes)

    def _truth(self, folder: ViewFolder, novel: list[View], notes: list[str]) -> Truth:
        where = str(folder.folder / "metadata.json")
        light = Path(text(where, folder.metadata, "envmap", "")).stem
        strength = number(where, folder.metadata, "envmap_inten") if "envmap_inten" in folder.metadata else STRENGTH
        names = [*([light] if light else []), *sorted({view.light for view in novel} - {"train"})]
        found, said = lights_below("reader.options.lights", self._lights, names)
        notes += said
        others = {name: radiance for name, radiance in found.items() if name != light}
        return Truth({"train": (strength * found[light]).astype("float32"), **others} if light in found else others)
