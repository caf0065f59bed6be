"""A scene as it would have been photographed: what the settings leave out is gone before anything is planned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from ia_bench.capture.radiometry import at_one_exposure, photographed
from ia_bench.capture.settings import MADE, CaptureSettings, FaultSettings
from ia_bench.common.errors import InputError
from ia_bench.common.progress import Begin, unseen
from ia_bench.scenes.scene import Scene, View, of_one_size

DOUBTS, MANY = (3, 1), 8
"""With MANY photographs or more, the hull that judges poses and masks lets three of them be wrong about a point, or one where
that leaves it open. With fewer, only ``capture.tolerated`` may be: such hulls are open more often, or move cameras away."""
IDLE = {
    "jpeg": ("radiometry", "ldr"), "turntable_axis": ("light", "turntable"), "smoothing": ("geometry", "smoothed"),
    "cells": ("geometry", "hull"), "sdf": ("geometry", "sdf"),
}  # fmt: skip
"""What no capture takes notice of but one with a certain value of another setting."""


def captured(scene: Scene, settings: CaptureSettings, note: Callable[[str], None], begin: Begin = unseen) -> Scene:
    """The scene with fewer views, other images, cameras and masks, or another mesh; held-out views and truth stay what they were.

    ``note`` is told what takes time; ``begin`` shows how far work of minutes is. Raises
    InputError for what the scene cannot give.
    """
    for key, (other, value) in IDLE.items():
        if getattr(settings, key) != getattr(CaptureSettings(), key) and getattr(settings, other) != value:
            note(f"capture.{key} changes nothing: capture.{other}={value} alone reads it, found {getattr(settings, other)}")
    if settings.views != "all":
        from ia_bench.capture.faults import spread_over_directions  # only here, as what follows: they bring in scipy and trimesh

        scene = replace(scene, train=spread_over_directions(scene.train, settings.views))
    scene = at_one_exposure(scene, note)
    train = scene.train
    if settings.tolerated >= len(train) and (settings.consistency or settings.geometry in MADE):
        raise InputError(f"capture.tolerated={settings.tolerated}: expected fewer than the {len(train)} photographs that are taken")
    train = of_one_size(train)
    if settings.radiometry == "ldr" or settings.background != "none" or settings.faults != FaultSettings():
        from ia_bench.capture.faults import blurred, misplaced, mistaken_masks

        before, cameras, masks = train, misplaced(train, settings.faults), mistaken_masks(train, settings.faults)
        photos = photographed(blurred(train, settings.faults), settings, masks)
        train = tuple(replace(photo, camera=camera) for photo, camera in zip(photos, cameras, strict=True))
        covered = [view.mask > 0 for view in train]
        clipped = (old.known & ~new.known & inside for old, new, inside in zip(before, train, covered, strict=True))
        lost = sum(int(pixels.sum()) for pixels in clipped)  # what a reader, masks or a margin make unknown is none of it
        scene = replace(scene, saturated_share=lost / max(sum(int(inside.sum()) for inside in covered), 1))
    if settings.consistency:
        note(f"capture.consistency={settings.consistency}: poses and masks are made to agree with each other")
        train = _agreeing(train, settings, note, begin)
    coloured = scene.white_balances_differ or settings.white_balance == "per_image"
    differ = scene.exposures_differ or settings.exposure == "per_image" or coloured
    shaped = replace(scene, train=train, exposures_differ=differ, white_balances_differ=coloured)
    if settings.light != "static":
        from ia_bench.capture.turntable import turning_light

        shaped = replace(shaped, turning=turning_light(shaped.train, settings, note))
    if settings.geometry != "given" or scene.mesh is None:
        from ia_bench.capture.shapes import with_geometry

        shaped = with_geometry(shaped, settings, note, begin)
        if shaped.turning is not None:  # its map is as it stands for the first photograph, which may have moved
            first = shaped.train[0].camera.to_world[:3].astype(float).tolist()
            shaped = replace(shaped, turning=replace(shaped.turning, start=tuple(map(tuple, first))))
    if not settings.margin:
        return shaped
    from ia_bench.capture.faults import inside

    return replace(shaped, train=inside(shaped.train, settings.margin, note))


def _agreeing(views: tuple[View, ...], settings: CaptureSettings, note: Callable[[str], None], begin: Begin) -> tuple[View, ...]:
    """The views with poses and masks that agree better, by a hull that tolerates as many wrong ones as DOUBTS says."""
    from ia_bench.geometry.consistency import consistent
    from ia_bench.geometry.hull import OpenHullError

    for doubted in (each for each in DOUBTS if each > settings.tolerated and len(views) >= MANY):
        try:
            return consistent(views, settings.consistency, doubted, begin)
        except OpenHullError:
            note(f"capture.consistency={settings.consistency}: a hull that tolerates {doubted} views is open; it tolerates fewer")
    return consistent(views, settings.consistency, settings.tolerated, begin)


def record(scene: Scene, settings: CaptureSettings) -> dict[str, Any]:
    """What metrics.json says of the capture of a ``scene`` that was captured by these ``settings``."""
    further: dict[str, Any] = {} if settings.faults == FaultSettings() else {"faults": asdict(settings.faults)}
    if any(view.exposure is not None for view in (*scene.test, *scene.novel)):
        further["recorded_exposures"] = "divided out"
    if scene.white_balances_differ:
        further["white_balance"] = "per_image"
    if scene.turning is not None:
        poses = np.stack([view.camera.to_world for view in scene.train])
        turning = scene.turning
        angles = {} if not turning.rounds else {"degrees": np.degrees(turning.angles(poses)).round(3).tolist()}
        further["turning"] = {**turning.record(), **angles}
    return {
        "views": len(scene.train),
        "radiometry": settings.radiometry,
        "exposure": "per_image" if scene.exposures_differ else "fixed",
        "geometry": settings.geometry,
        "triangles": 0 if scene.mesh is None else len(scene.mesh.faces),
        "saturated_share": scene.saturated_share,
        **further,
    }
