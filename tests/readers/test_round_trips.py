"""Every format of others' data: the scene `tiny`, written as that format describes it, is read back as what it was.

Cameras are compared to 1e-6, photographs to their quantisation, truth to the truth. To add a format, write its writer
(ia_bench/readers/writers/) from its description and a line of layouts.py. A mirror ball proves how each format lays a light out.
"""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from layouts import (
    LAYOUTS,
    STEP,
    TINTS,
    TRAIN_LIGHT,
    Layout,
    ball_seen,
    blender_map,
    expect_camera,
    expect_photo,
    reflected,
    scene_to_write,
    with_maps,
)

from ia_bench.checks.finding import difference
from ia_bench.common.registry import create, find
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.readers.base import FolderReader
from ia_bench.readers.contract import SPLITS, TRUTH_OF_VIEWS, check_scene, unscored
from ia_bench.readers.writers.parts import Options, held_out
from ia_bench.render.agreement import GOOD, check_agreement
from ia_bench.scenes.images import straight
from ia_bench.scenes.scene import Scene, View

Written = dict[str, tuple[Path, Options]]
every_layout = pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.id)
of_others = pytest.mark.parametrize("layout", [one for one in LAYOUTS if one.name != "native"], ids=lambda layout: layout.id)


def read(layout: Layout, folder: Path, given: Options, *, truth: bool = True, **options: object) -> Scene:
    """The scene that a reader finds in a folder, as a run gets it."""
    return check_scene(made(layout, folder, given, **options).read(truth), truth=truth)


def made(layout: Layout, folder: Path, given: Options, **options: object) -> FolderReader:
    """The reader of ``folder``, with the options that its writer told."""
    target = find("reader", layout.name).target
    reader: FolderReader = create("reader", layout.name, target, {**given, **options}, folder / layout.root)
    return reader


@pytest.fixture
def folder(layout: Layout, written: Written) -> Path:
    return written[layout.id][0]


@pytest.fixture
def given(layout: Layout, written: Written) -> Options:
    return written[layout.id][1]


@every_layout
def test_what_was_written_is_read_back(layout: Layout, folder: Path, given: Options, tiny: Scene) -> None:
    scene, expected = read(layout, folder, given), layout.expected(scene_to_write(tiny))
    for split in SPLITS:
        assert [view.light for view in getattr(scene, split)] == [view.light for view in getattr(expected, split)]
        for view, one in zip(getattr(scene, split), getattr(expected, split), strict=True):
            expect_camera(view.camera, one.camera)
            expect_photo(view, one, layout, split)
    for view, one in zip(scene.test, expected.test, strict=True):
        assert {name for name in ("albedo", "roughness", "normal") if getattr(view, name) is not None} == set(layout.known)
        for name in layout.known:
            true = getattr(one, name)
            if layout.binary:
                true = (straight(true, one.mask).T * (one.mask.T > 0.5)).T
            expect_truth(name, getattr(view, name), true, one.mask)
    assert check_agreement(scene, lambda line: None) >= GOOD


def expect_truth(name: str, found: np.ndarray, true: np.ndarray, mask: np.ndarray) -> None:
    """Values as far as 8 bits of them and of alpha tell. Normals are stored at unit length: those of flat pixels are compared."""
    if name == "normal":
        length = np.linalg.norm(true, axis=-1)
        flat = (mask == 1) & (length > 0.999)
        assert flat.sum() > 50
        assert np.abs(found[flat] - true[flat] / length[flat, None]).max() <= 2.5 * STEP
    else:
        assert np.abs(found - true).max() <= 3 * STEP


@every_layout
def test_without_truth_the_same_photographs_and_nothing_else(layout: Layout, folder: Path, given: Options) -> None:
    blind, told = (read(layout, folder, given, truth=truth) for truth in (False, True))
    assert blind.truth is None
    for split in SPLITS:
        for one, other in zip(getattr(blind, split), getattr(told, split), strict=True):
            assert np.array_equal(one.image, other.image)


@of_others
def test_the_files_that_a_reader_names_are_all_that_it_reads(layout: Layout, folder: Path, given: Options, tmp_path: Path) -> None:
    """Where nothing else is there, the scene is the same. What lies in the folder besides is not among them."""
    (folder / "a_note.md").write_text("not read")
    files = made(layout, folder, given).files()
    assert files == sorted(set(files))
    for path in files:
        if path.is_relative_to(folder):
            (tmp_path / path.relative_to(folder)).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, tmp_path / path.relative_to(folder))
    assert sum(path.is_file() for path in tmp_path.rglob("*")) < sum(path.is_file() for path in folder.rglob("*"))
    for truth in (False, True):
        copy = check_scene(made(layout, tmp_path, given).read(truth), truth=truth)
        scenes = copy, read(layout, folder, given, truth=truth)
        assert difference(*(replace(scene, name="", source="", notes=()) for scene in scenes)) is None


@of_others
def test_smaller_images_and_fewer_held_out_views(layout: Layout, folder: Path, given: Options) -> None:
    whole, small = read(layout, folder, given), read(layout, folder, given, shrink=4, held_out=2)
    split = "test" if whole.test else "novel"
    names = [{view.name for view in getattr(scene, split)} for scene in (small, whole)]
    assert len({view.camera.to_world.tobytes() for view in getattr(small, split)}) == 2
    assert names[0] < names[1]
    np.testing.assert_allclose(small.train[0].image.mean(), whole.train[0].image.mean(), rtol=1e-5)
    assert small.train[0].camera.focal[0] == whole.train[0].camera.focal[0] / 4
    by_name = {view.name: view for view in whole.test}
    for view in small.test:  # truth is premultiplied: a larger pixel has the mean of it
        for name in TRUTH_OF_VIEWS:
            found, true = getattr(view, name), getattr(by_name[view.name], name)
            assert (found is None) == (true is None)
            if found is not None:
                np.testing.assert_allclose(found, blocks(true, 4), atol=1e-5)
    assert check_agreement(small, lambda line: None) >= GOOD


def blocks(values: np.ndarray, side: int) -> np.ndarray:
    """The mean of every ``side`` x ``side`` pixels."""
    height, width = values.shape[0] // side, values.shape[1] // side
    return values.reshape(height, side, width, side, *values.shape[2:]).mean((1, 3))


def test_a_zoom_on_a_tripod_is_two_held_out_cameras(tiny: Scene) -> None:
    wide = tiny.test[0]
    tele = replace(wide, name="tele", camera=replace(wide.camera, focal=(99.0, 99.0)))
    cameras = held_out(replace(tiny, test=(wide, tele), novel=(tele, replace(wide, light="night"))))
    assert [(view.name, len(relit)) for view, relit in cameras] == [(wide.name, 1), ("tele", 0)]


@every_layout
def test_what_cannot_be_scored(layout: Layout, folder: Path, given: Options) -> None:
    lacking = unscored(read(layout, folder, given))
    assert ("view_synthesis" in lacking) == (layout.name == "objects_with_lighting")
    assert ("relighting" in lacking) == (not layout.lights or "albedo" not in layout.known)
    assert ("albedo" in lacking, "roughness" in lacking) == ("albedo" not in layout.known, "roughness" not in layout.known)


with_lights = pytest.mark.parametrize("layout", [one for one in LAYOUTS if one.lights], ids=lambda layout: layout.id)


@with_lights
def test_lights_are_read_as_what_they_were(layout: Layout, folder: Path, given: Options) -> None:
    scene = read(layout, folder, given)
    assert {view.light for view in scene.novel} - {"train"} <= set(scene.truth.lights)
    for name, radiance in scene.truth.lights.items():
        true = blender_map(layout.formula(name), len(radiance))  # the layout that is ours, too
        exact = true.max(-1, keepdims=True) / 128 + 1e-5  # a mantissa of 8 bits, cut off
        assert (
            np.abs(radiance - true) <= exact + (0.05 if layout.name == "stanford_orb" else 0)
        ).all()  # which is resampled, from texels of 6 degrees


@with_lights
def test_a_mirror_ball_shows_the_light_that_the_map_holds(layout: Layout, tmp_path: Path, tiny: Scene) -> None:
    """Photographs of a ball that reflects a light: what its map holds where the ball reflects to is what they show."""
    test = tuple(ball_seen(view, TRAIN_LIGHT) for view in tiny.test)
    novel = tuple(
        v for one, view in zip(test, tiny.test, strict=True) for v in (one, *(relit_ball(view, light) for light in TINTS))
    )
    ball = replace(with_maps(tiny), train=tuple(ball_seen(view, TRAIN_LIGHT) for view in tiny.train), test=test, novel=novel)
    scene = read(layout, tmp_path / "ball", layout.write(tmp_path / "ball", ball))
    views = [view for view in (*scene.train, *scene.novel) if view.light in scene.truth.lights]
    assert ball_error(views, scene.truth.lights) < 0.025  # of texels of 6 degrees, .02, and of 8 bits
    for spoil in WRONG_MAPS:
        assert ball_error(views, {name: spoil(radiance).copy() for name, radiance in scene.truth.lights.items()}) > 0.04


WRONG_MAPS = (  # mirrored, upside down, turned by a quarter and by a half
    lambda radiance: radiance[:, ::-1],
    lambda radiance: radiance[::-1],
    lambda radiance: np.roll(radiance, radiance.shape[1] // 4, 1),
    lambda radiance: np.roll(radiance, radiance.shape[1] // 2, 1),
)


def relit_ball(view: View, light: str) -> View:
    return replace(ball_seen(view, light), light=light)


def ball_error(views: list[View], lights: dict[str, np.ndarray]) -> float:
    """The mean difference between what a mirror ball shows in photographs and what their maps hold where it reflects to."""
    errors = []
    for view in views:
        directions, hit = reflected(view.camera, 0.6)
        inside = hit & (view.mask > 0.99)
        held = LatLongEnvironment(torch.from_numpy(lights[view.light])).radiance(torch.from_numpy(directions[inside])).numpy()
        errors.append(np.abs(held.clip(max=1) - view.image[inside].clip(max=1)))
    return float(np.concatenate(errors).mean())
