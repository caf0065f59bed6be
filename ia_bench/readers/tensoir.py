"""Reader of TensoIR-Synthetic (Jin et al., CVPR 2023): folders train_NNN and test_NNN (:mod:`ia_bench.readers.view_folders`).

Training and held-out photographs are ``rgba_sunset_000.png``: a light and the angle by which it was turned. Held-out views are
also there under novel lights, ``rgba_bridge.png`` and others, whose maps are a download of their own: ``lights``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ia_bench.readers.view_folders import ViewFolder, ViewFolders

TURNED = re.compile(r"_\d{3}$")  # the name of a light that was turned by so many degrees


@dataclass(frozen=True, kw_only=True)
class TensoirReader(ViewFolders):
    """Reads the folder of one object.

    Attributes:
        light: What the training photographs were taken under ...
        rotation: ... turned by so many degrees.
    """

    format = "tensoir"
    light: str = "sunset"
    rotation: str = "000"

    @property
    def photographs(self) -> Sequence[str]:
        """The names of photographs under the training light."""
        return f"rgba_{self.light}_{self.rotation}.png", f"rgba_{self.light}.png"

    def novel_lights(self, folder: ViewFolder) -> Mapping[str, Path]:
        """The photographs under lights that are not turned."""
        return {light: path for light, path in folder.lights().items() if light != self.light and not TURNED.search(light)}

    def own_light(self, folder: ViewFolder) -> tuple[str, float]:
        """The training light's map; a turned one is not among the files."""
        return (self.light if self.rotation == "000" else ""), 1.0
