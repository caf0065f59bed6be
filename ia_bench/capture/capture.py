"""A scene as it would have been photographed: what the settings leave out is gone before anything is planned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ia_bench.capture.radiometry import photographed
from ia_bench.capture.settings import CaptureSettings
from ia_bench.capture.shapes import with_geometry
from ia_bench.capture.views import spread
from ia_bench.scenes.padding import of_one_size
from ia_bench.scenes.scene import Scene


def captured(scene: Scene, settings: CaptureSettings, note: Callable[[str], None]) -> Scene:
    """The scene with fewer views, other images or another mesh; held-out views and truth stay what they were.

    ``note`` is told what takes time. Raises InputError for what the scene cannot give.
    """
    train = scene.train
    if settings.views != "all":
        train = spread(train, settings.views)
    train = of_one_size(train)
    per_image = settings.exposure == "per_image"
    if settings.radiometry == "ldr":
        train = photographed(train, settings.percentile, per_image=per_image)
    elif per_image:
        note("capture.exposure=per_image changes nothing with capture.radiometry=hdr, whose images are in one unit")
    differ = scene.exposures_differ or (settings.radiometry == "ldr" and per_image)
    return with_geometry(replace(scene, train=train, exposures_differ=differ), settings, note)


def record(scene: Scene, settings: CaptureSettings) -> dict[str, Any]:
    """What metrics.json says of the capture of a ``scene`` that was captured by these ``settings``."""
    saturated = [float((~view.valid & (view.mask > 0)).sum()) for view in scene.train if view.valid is not None]
    covered = sum(float((view.mask > 0).sum()) for view in scene.train)
    return {
        "views": len(scene.train),
        "radiometry": settings.radiometry,
        "exposure": "per_image" if scene.exposures_differ else "fixed",
        "geometry": settings.geometry,
        "triangles": 0 if scene.mesh is None else len(scene.mesh.faces),
        "saturated_share": float(np.sum(saturated)) / max(covered, 1.0),
    }
