"""What pixels betray: how far sound scenes are from a warning, and that spoiled ones get it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ia_bench.readers.base import FADED, GLARING, edge_colour, in_eight_bits, warnings_of
from ia_bench.readers.native import NativeReader
from ia_bench.scenes.scene import Scene, View


def times_alpha(view: View, power: int) -> View:
    alpha = np.where(view.mask > 0, view.mask, 1)[..., None]
    return replace(view, image=(view.image * alpha**power).astype(np.float32))


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("hat", "ship", "console", "figurine")]


@pytest.mark.parametrize("name", ["tiny", *SLOW])
def test_no_shipped_scene_is_suspected(name: str, tiny_folder: Path) -> None:
    """Edges of the shipped scenes are .80 to 1.25 times as bright as what is beside them: a third of the way to a warning."""
    views = NativeReader(tiny_folder.parent / name).read(truth=False).train[::4]
    ratio = edge_colour(views)
    assert ratio is not None
    assert FADED * 1.3 < ratio < GLARING / 1.3
    assert list(warnings_of(views)) == []


def test_alpha_once_too_often_or_too_seldom(tiny: Scene) -> None:
    (twice,) = warnings_of([times_alpha(view, 1) for view in tiny.train])
    assert "multiplied by alpha twice" in twice
    (never,) = warnings_of([times_alpha(view, -1) for view in tiny.train])
    assert "not to be multiplied by alpha" in never
    assert list(warnings_of([times_alpha(view, -1) for view in tiny.train], own_alpha=False)) == []  # edges show a background
    assert edge_colour(tiny.train[:1]) is None  # too few pixels to tell


def test_eight_bits_stored_as_linear(tiny: Scene) -> None:
    stepped = [
        replace(v, image=(np.round(255 * v.image.clip(0, 1)) / 255).astype(np.float16).astype(np.float32)) for v in tiny.train
    ]
    assert in_eight_bits(stepped)
    assert not in_eight_bits(tiny.train)
