"""What the check says of the views of a capture, and which of them its picture has: counted by hand."""

from __future__ import annotations

from dataclasses import replace

from ia_bench.checks.contact_sheet import _cameras, counted, splits
from ia_bench.scenes.scene import Scene


def test_photographs_that_are_test_and_novel_views_are_held_out_once(tiny: Scene) -> None:
    own = replace(tiny, novel=tiny.test)
    assert counted(own) == "16 train, 4 held-out views"
    assert {split: len(matrices) for split, matrices in _cameras(own).items()} == {"train": 16, "held-out": 4}


def test_views_under_other_lights_are_novel_ones(tiny: Scene) -> None:
    assert counted(tiny) == f"16 train, 4 test, {len(tiny.novel)} novel views"
    other = replace(tiny, novel=tuple(replace(view, light="studio") for view in tiny.test))
    assert list(splits(other)) == ["train", "test", "novel"]
    assert {split: len(matrices) for split, matrices in _cameras(other).items()} == {"train": 16, "test": 4}  # the same cameras
    assert counted(replace(tiny, test=(), novel=())) == "16 train views"


def test_a_picture_says_how_many_views_it_leaves_out(tiny: Scene) -> None:
    own = replace(tiny, train=(*tiny.train, tiny.train[0]), novel=tiny.test)
    assert counted(own, {"train": 16, "held-out": 4}) == "17 train (16 of 17 shown), 4 held-out views"
