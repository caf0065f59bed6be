"""Rendering under a light part by part, with the samples where the noise is."""

import tempfile
from pathlib import Path

import numpy as np
from cameras import split_poses
from light_parts import Part, write_parts
from numpy.typing import NDArray
from passes import Passes, combine
from renderer import Renderer

PILOT_SAMPLES = 24
"""Paths a pixel of the renders that measure how noisy each part is."""

PILOT_CAMERAS = (0.3, 0.8)
"""Their cameras, as fractions of the novel cameras' path."""

MIN_SAMPLES = 8
"""Paths a pixel of every part, however quiet it is."""


class SplitRenderer:
    """Renders views of the Blender scene under the lights of a scene folder, each split by `light_parts`.

    A part's share of the samples is proportional to the standard deviation of its samples (Neyman's allocation, the
    least variance of a sum at a given cost), as a pilot measures it: the mean absolute difference of two seeds. Squares
    would hand the samples to the part with the rarest and brightest path.
    """

    def __init__(self, renderer: Renderer, lights: dict[str, Path], cameras: int, least_power: float) -> None:
        """Split `lights` (name to lat-long EXR file) at `least_power`; run the pilot from two of the `cameras` novel cameras."""
        self._renderer = renderer
        self._scratch = tempfile.TemporaryDirectory(prefix="lights-")
        poses = split_poses("novel", cameras)
        self._pilot = [poses[int(fraction * cameras)] for fraction in PILOT_CAMERAS]
        self._parts = {
            name: self._allocate(write_parts(path, Path(self._scratch.name), least_power)) for name, path in lights.items()
        }

    def shares(self) -> dict[str, list[float]]:
        """Share of the samples by light and part: the rest of the light first, then its bright sources."""
        return {name: [round(part.share, 3) for part in parts] for name, parts in self._parts.items()}

    def _allocate(self, paths: list[Path]) -> list[Part]:
        noise = []
        for path in paths:
            self._renderer.set_light(path)
            pairs = [[self._renderer.render(pose, PILOT_SAMPLES, seed) for seed in (1, 2)] for pose in self._pilot]
            noise.append(float(np.mean([np.abs(a.rgba - b.rgba)[..., :3].mean() for a, b in pairs])))
        return [Part(path, value / sum(noise)) for path, value in zip(paths, noise, strict=True)]

    def render(self, light: str, pose: NDArray[np.float64], samples: int, seed: int = 0, *, direct_only: bool = False) -> Passes:
        """Render from `pose` (4, 4) under a light with `samples` paths a pixel, all parts together.

        `direct_only` keeps only light that arrives at the object unreflected.
        """
        parts = self._parts[light]
        counts = [max(MIN_SAMPLES, round(part.share * samples)) for part in parts]
        rendered = []
        for index, (part, count) in enumerate(zip(parts, counts, strict=True)):
            self._renderer.set_light(part.path)
            # Seeds of their own: with shared ones the parts would miss the same edges, and their errors would add up.
            rendered.append(self._renderer.render(pose, count, seed * len(parts) + index, direct_only=direct_only))
        return combine(rendered, counts)
