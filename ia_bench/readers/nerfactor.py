"""Reader of NeRFactor's synthetic scenes (Zhang et al., SIGGRAPH Asia 2021), see :mod:`ia_bench.readers.view_folders`.

Folders are train_NNN, val_NNN and test_NNN. Photographs are ``rgba.png``, under the map that metadata.json calls ``envmap``
*times* ``envmap_inten`` (3); held-out views are also there under novel maps at strength 1, ``rgba_city.png`` and others, and
under single point lights, ``rgba_olat-*.png``, which no environment map stands for and which are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ia_bench.readers.fields import number, text
from ia_bench.readers.view_folders import ViewFolder, ViewFolders

STRENGTH = 3.0  # of the training light, where metadata.json does not say it
POINT_LIGHT = "olat"


@dataclass(frozen=True, kw_only=True)
class NerfactorReader(ViewFolders):
    """Reads the folder of one object."""

    format = "nerfactor"
    held_out_splits = ("val", "test")
    photographs = ("rgba.png",)

    def novel_lights(self, folder: ViewFolder) -> Mapping[str, Path]:
        """The photographs under maps."""
        return {light: path for light, path in folder.lights().items() if not light.startswith(POINT_LIGHT)}

    def own_light(self, folder: ViewFolder) -> tuple[str, float]:
        """The map that metadata.json names, and its strength."""
        where, said = str(folder.folder / "metadata.json"), folder.metadata
        strength = number(where, said, "envmap_inten") if "envmap_inten" in said else STRENGTH
        return Path(text(where, said, "envmap", "")).stem, strength
