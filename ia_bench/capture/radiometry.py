"""Images as an ordinary camera keeps them: exposed, clipped, eight bits of sRGB; and read back as users' photographs are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from io import BytesIO
from typing import Any

import numpy as np
from PIL import Image

from ia_bench.capture.settings import CaptureSettings
from ia_bench.common.errors import InputError
from ia_bench.scenes.color import linear_to_srgb, srgb_to_linear
from ia_bench.scenes.images import straight
from ia_bench.scenes.scene import Scene, View

COVERED = 0.5  # of a pixel that counts for the exposure
WHITE = 255
ALIKE = 1e-3  # by which recorded exposures may differ and count as one


def photographed(views: Sequence[View], settings: CaptureSettings, masks: Sequence[np.ndarray]) -> tuple[View, ...]:
    """The views as ``settings`` photograph them, cut out by ``masks`` (H, W), in the units of the scene.

    A picture shows the object, and around it ``settings.background``. With "ldr" it goes through eight bits: one exposure, or
    one for each image, lets ``percentile`` percent of the object's pixels stay below the clip. A pixel of which a channel reads
    255 is not ``valid``. One exposure is known, as from a camera's record, and divided out. Exposures of single images are not:
    of these only the geometric mean is divided out, and each image keeps its own factor, which is unknown.
    """
    percentile = settings.percentile
    brightest = [_picture(view, None).max(-1)[view.mask > COVERED] for view in views]
    ldr, background, common = settings.radiometry == "ldr", None, 1.0
    if ldr or settings.background != "none":
        common = _exposure(np.concatenate(brightest), percentile, "all training views")
    if settings.background != "none":
        background = settings.background / common
    pictures = (_picture(view, background) for view in views)  # one by one, for in double precision all would fill the memory
    if not ldr:
        return tuple(_cut_out(*each) for each in zip(views, pictures, masks, strict=True))
    exposures = [common] * len(views)
    if settings.exposure == "per_image":
        exposures = [_exposure(values, percentile, view.name) for values, view in zip(brightest, views, strict=True)]
    unit = float(np.exp(np.mean(np.log(exposures))))
    taken = []
    for view, picture, exposure, mask in zip(views, pictures, exposures, masks, strict=True):
        codes = eight_bits(exposure * picture)
        if settings.jpeg != "none":
            codes = through_jpeg(codes, settings.jpeg)
        view = replace(view, valid=view.known & ~((codes == WHITE).any(-1) & (mask > 0)))
        if view.specular is not None and settings.exposure == "per_image":  # whose truth is in the unit of its photograph
            view = replace(view, specular=view.specular * (exposure / unit))
        taken.append(_cut_out(view, srgb_to_linear(codes / WHITE) / unit, mask))
    return tuple(taken)


def at_one_exposure(scene: Scene, note: Callable[[str], None]) -> Scene:
    """The scene with its training images divided by the exposures that cameras recorded, where all did and they differ.

    The unit of radiance is that of the mean exposure (geometric) of the training views. Held-out photographs stay as they were
    taken, and say by which factor a render has to be exposed to be compared with them.
    """
    held_out = [view for view in (*scene.test, *scene.novel) if view.light == "train"]  # most readers have them in both
    lit = [*scene.train, *{(view.name, view.camera.to_world.tobytes()): view for view in held_out}.values()]
    known = [view.exposure for view in lit if view.exposure is not None]
    if not known:
        return scene
    if len(known) < len(lit):
        note(f"{len(lit) - len(known)} of {len(lit)} photographs have no recorded exposure: all are taken for the same")
    ratio = max(known) / min(known) if len(known) == len(lit) else 1.0
    differ = ratio - 1 > ALIKE
    if differ:
        note(f"recorded exposures differ by up to {ratio:.3g} times: divided out; capture.exposure=per_image fits what is left")
    unit = float(np.exp(np.mean(np.log([view.exposure or 1.0 for view in scene.train]))))

    def relative(view: View) -> View:
        return replace(view, exposure=view.exposure / unit if view.exposure and differ and view.light == "train" else None)

    def at_unit(view: View) -> View:
        factor = np.float32(view.exposure or 1.0)
        specular = None if view.specular is None else view.specular / factor
        return replace(view, image=view.image / factor, specular=specular, exposure=None)

    train = map(relative, scene.train)
    return replace(
        scene,
        train=tuple(map(at_unit, train)),
        test=tuple(map(relative, scene.test)),
        novel=tuple(map(relative, scene.novel)),
    )


def eight_bits(radiance: np.ndarray) -> np.ndarray:
    """Radiance as the codes 0 to 255 of its sRGB, clipped at 1."""
    return np.round(WHITE * linear_to_srgb(radiance.clip(0, 1)))


def through_jpeg(codes: np.ndarray, quality: int) -> np.ndarray:
    """What a picture (H, W, 3) of codes from 0 to 255 is after it was stored as a JPEG with chroma at half resolution."""
    stored = BytesIO()
    Image.fromarray(codes.astype(np.uint8)).save(stored, "JPEG", quality=quality, subsampling="4:2:0")
    with Image.open(stored) as picture:
        return np.asarray(picture.convert("RGB"), np.float64)


def _cut_out(view: View, picture: np.ndarray, mask: np.ndarray) -> View:
    """The view of a ``picture`` that is cut out by another mask, and so is what is true of it."""
    kept = np.minimum(mask / np.maximum(view.mask, 1e-6), 1)[..., None].astype(np.float32)
    truth: dict[str, Any] = {name: values * kept for name in ("albedo", "specular") if (values := getattr(view, name)) is not None}
    return replace(view, image=(picture * mask[..., None]).astype(np.float32), mask=mask, **truth)


def _picture(view: View, background: float | None) -> np.ndarray:
    """The radiance of all pixels (H, W, 3): colours of the object alone, black around it, or the object before a background."""
    if background is not None:
        behind: np.ndarray = view.image + (1 - view.mask[..., None]) * background
        return behind
    return straight(view.image, view.mask).astype(np.float64)


def _exposure(values: np.ndarray, percentile: float, what: str) -> float:
    level = float(np.percentile(values, percentile)) if len(values) else 0.0
    if level <= 0:
        raise InputError(f"capture: expected light in {what}, found {percentile:g} % of the object's pixels black")
    return 1 / level
