"""Every way to the truth of `tiny` is found, and nothing is found in what has none."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from ia_bench.capture.capture import captured
from ia_bench.capture.settings import CaptureSettings
from ia_bench.checks.blindness import leaks, with_other_truth
from ia_bench.scenes.scene import Scene


def closing_over(value: object) -> Callable[[], object]:
    return lambda: value


class Holder:
    __slots__ = ("held",)

    def __init__(self, held: object) -> None:
        self.held = held

    def method(self) -> None:
        pass


@pytest.mark.parametrize(
    "wrap",
    [
        lambda value: value,
        lambda value: {"a": [value]},
        closing_over,
        lambda value: functools.partial(print, file=value),
        lambda value: Holder(value).method,
        lambda value: SimpleNamespace(inner=(value,)),
    ],
    ids=["itself", "in a list", "in a closure", "in a partial", "behind a bound method", "in an attribute"],
)
def test_truth_is_found_wherever_it_is_held(wrap: Callable[[object], object], tiny: Scene, tiny_folder: Path) -> None:
    blind = tiny.blind()
    seen = tiny.test[0]
    for told in (tiny, seen, seen.albedo.copy(), torch.from_numpy(tiny.truth.lights["train"]), tiny_folder, str(tiny_folder)):
        assert leaks(wrap(told), tiny), told
    for untold in (blind, blind.train[0].image, torch.ones(3, 3), "a text", Path("relative"), print, None):
        assert leaks(wrap(untold), tiny) == [], untold


def test_the_true_mesh_is_secret_where_a_capture_has_put_another_into_its_place(tiny: Scene) -> None:
    smoothed = captured(tiny, CaptureSettings(geometry="smoothed"), lambda line: None)
    true, seen = tiny.expect_mesh(), smoothed.blind()
    assert leaks(seen, smoothed) == []
    assert leaks(true.uv, smoothed) == []  # smoothing keeps them
    assert leaks({"mesh": true}, smoothed) == ["dict['mesh'].normals", "dict['mesh'].vertices"]
    assert leaks(true.normals.copy(), smoothed)
    kept = replace(smoothed, mesh=replace(smoothed.expect_mesh(), normals=true.normals))
    assert leaks(kept.blind(), kept) == []  # what the capture hands over is no secret
    assert leaks(true, tiny) == []


def test_another_truth_has_another_true_mesh(tiny: Scene) -> None:
    smoothed = captured(tiny, CaptureSettings(geometry="smoothed"), lambda line: None)
    other = with_other_truth(smoothed)
    assert other.mesh is smoothed.mesh
    assert other.truth is not None
    assert other.truth.mesh is not None
    assert not np.array_equal(other.truth.mesh.vertices, tiny.expect_mesh().vertices)
    assert not np.array_equal(other.truth.mesh.normals, tiny.expect_mesh().normals)


def test_the_way_is_told(tiny: Scene) -> None:
    assert leaks({"views": [replace(tiny.blind().train[0], albedo=tiny.train[0].albedo)]}, tiny) == [
        "dict['views'][0]",
        "dict['views'][0].albedo",
    ]


def test_what_holds_itself_ends(tiny: Scene) -> None:
    ring: list[object] = [tiny.blind()]
    ring.append(ring)
    assert leaks(ring, tiny) == []
