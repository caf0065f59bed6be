"""What a capture leaves out, one setting at a time, and that truth stays what it was."""

from dataclasses import replace

import numpy as np
import pytest
from shapes import camera_at

from ia_bench.capture.capture import captured, record
from ia_bench.capture.faults import spread_over_directions
from ia_bench.capture.radiometry import eight_bits, photographed
from ia_bench.capture.settings import CaptureSettings, SdfSettings, shipped
from ia_bench.common.errors import InputError
from ia_bench.scenes.scene import Scene, View, farthest_first
from ia_bench.scenes.turning import TurningLight

pytestmark = pytest.mark.usefixtures("no_cache")


def take(scene: Scene, **settings: object) -> Scene:
    return captured(scene, CaptureSettings(**settings), lambda line: None)  # type: ignore[arg-type]


def test_the_default_leaves_everything_in(tiny: Scene) -> None:
    after = take(tiny)
    assert all(a is b for a, b in zip(after.train, tiny.train, strict=True))
    assert after.mesh is tiny.mesh
    assert after.truth is tiny.truth
    assert record(after, CaptureSettings()) == {
        "views": 16, "radiometry": "hdr", "exposure": "fixed", "geometry": "given",
        "triangles": len(tiny.expect_mesh().faces), "saturated_share": 0.0,
    }  # fmt: skip


def test_a_setting_that_nothing_reads_is_told(tiny: Scene) -> None:
    told: list[str] = []
    after = captured(tiny, CaptureSettings(jpeg=20, light="camera", sdf=SdfSettings(align=True)), told.append)
    assert after.train[0].image is tiny.train[0].image
    assert told == [
        "capture.jpeg changes nothing: capture.radiometry=ldr alone reads it, found hdr",
        "capture.sdf changes nothing: capture.geometry=sdf alone reads it, found given",
    ]


# ---------------------------------------------------------------- views
def widest_gap(views: tuple[View, ...], among: tuple[View, ...]) -> float:
    """The largest angle from the direction of a camera of ``among`` to the nearest of ``views``; objects lie at the origin."""
    one, all_of_them = (np.stack([v.camera.to_world[:3, 3] for v in part]) for part in (views, among))
    one, all_of_them = (part / np.linalg.norm(part, axis=1, keepdims=True) for part in (one, all_of_them))
    return float(np.degrees(np.arccos((all_of_them @ one.T).max(1).clip(-1, 1).min())))


def test_views_are_nested_and_spread(tiny: Scene) -> None:
    names = {count: [view.name for view in spread_over_directions(tiny.train, count)] for count in (1, 4, 8, 16)}
    assert set(names[1]) < set(names[4]) < set(names[8]) < set(names[16])
    assert names[8] == sorted(names[8])
    assert sorted(farthest_first(tiny.train, np.zeros(3))) == list(range(16))
    random = np.random.default_rng(0)
    gaps = [widest_gap(tuple(tiny.train[i] for i in random.permutation(16)[:4]), tiny.train) for _ in range(200)]
    assert widest_gap(spread_over_directions(tiny.train, 4), tiny.train) < np.quantile(gaps, 0.1)


# ---------------------------------------------------------------- radiometry
def made_up(values: list[float], mask: float = 1.0, name: str = "0") -> View:
    """A row of grey pixels of these radiances and one coverage."""
    image = np.array(values, np.float32)[None, :, None].repeat(3, -1)
    camera = replace(camera_at((0.0, 0.0, 3.0)), width=len(values), height=1)
    return View(name, camera, image * np.float32(mask), np.full((1, len(values)), mask, np.float32))


def test_codes_exposure_clip_and_saturation_by_hand(tiny: Scene) -> None:
    """sRGB of .5 is .7354, of .0015 in the linear part .01938; the codes are 187.5 and 4.94, rounded."""
    assert eight_bits(np.array([0.0, 0.0015, 0.5, 1.0, 3.0])).tolist() == [0, 5, 188, 255, 255]
    # half of five pixels at most: 1, 2, 4, 6, 8 are exposed by 1/4, so 4 is the clip; codes of 1/4 and 1/2 are 137 and 188
    (view,) = ldr([made_up([1, 2, 4, 6, 8], mask=0.6)], 50)
    decoded = [((code / 255 + 0.055) / 1.055) ** 2.4 for code in (137, 188, 255, 255, 255)]
    np.testing.assert_allclose(view.image[0, :, 0], 4 * 0.6 * np.array(decoded), rtol=1e-5)
    assert view.valid[0].tolist() == [True, True, False, False, False]
    scene = replace(tiny, train=(made_up([1, 2, 4, 6, 8]),))
    assert take(scene, radiometry="ldr", percentile=50.0).saturated_share == pytest.approx(3 / 5)
    with pytest.raises(InputError, match="expected light in all training views"):
        ldr([made_up([0, 0])], 98)


def ldr(views: list[View], percentile: float, **settings: object) -> tuple[View, ...]:
    """The views through eight bits, with their own masks."""
    chosen = CaptureSettings(radiometry="ldr", percentile=percentile, **settings)  # type: ignore[arg-type]
    return photographed(views, chosen, [view.mask for view in views])


def test_one_exposure_is_divided_out_and_many_are_not() -> None:
    bright, dark = made_up([8, 8, 8, 2]), made_up([2, 2, 2, 0.5], name="1")
    one = ldr([bright, dark], 100)
    np.testing.assert_allclose(one[1].image.mean() / one[0].image.mean(), 0.25, rtol=0.02)
    each = ldr([bright, dark], 100, exposure="per_image")
    np.testing.assert_allclose(each[0].image, each[1].image)  # exposures of 1/8 and 1/2 make them alike ...
    np.testing.assert_allclose(each[0].image[0, 0, 0], 4, rtol=1e-5)  # ... in the unit of their geometric mean, 1/4
    lit = [replace(view, specular=0.5 * view.image) for view in (bright, dark)]
    for view in ldr(lit, 100, exposure="per_image"):  # what a prior that sees the truth is told is as its photograph
        np.testing.assert_allclose(view.specular, 0.5 * view.image, rtol=0.02)


def test_ldr_captures_say_what_they_lost(tiny: Scene) -> None:
    after = take(tiny, radiometry="ldr", percentile=90.0)
    told = record(after, CaptureSettings(radiometry="ldr"))
    assert 0.05 < told["saturated_share"] < 0.2
    for before, view in zip(tiny.train, after.train, strict=True):
        inside = view.mask > 0.5
        assert (view.image[~view.valid] <= before.image[~view.valid] + 0.005 * before.image.max()).all()  # a bound from below
        known = inside & view.valid
        assert np.abs(view.image[known] - before.image[known]).max() < 0.02 * before.image.max()
    assert [v.image.tobytes() for v in after.novel] == [v.image.tobytes() for v in tiny.novel]
    assert after.exposures_differ is False
    assert take(tiny, radiometry="ldr", exposure="per_image").blind().exposures_differ is True
    assert after.white_balances_differ is False
    coloured = take(tiny, white_balance="per_image").blind()
    assert (coloured.exposures_differ, coloured.white_balances_differ) == (True, True)  # whose exposures then differ as well
    assert record(coloured, CaptureSettings(white_balance="per_image"))["white_balance"] == "per_image"
    assert CaptureSettings(white_balance="per_image").label == "white balance per image"


def test_only_what_was_clipped_counts_as_saturated(tiny: Scene) -> None:
    """A margin and masks that are put right make pixels unknown, too; so does a reader."""
    clipped = {"radiometry": "ldr", "percentile": 90.0}
    marked = {"margin": 2.0, "consistency": 1}
    shares = [
        record(take(tiny, **settings), CaptureSettings(**settings))["saturated_share"]  # type: ignore[arg-type]
        for settings in (clipped, clipped | marked, marked)
    ]
    assert shares[0] == shares[1] > 0
    assert shares[2] == 0.0
    unknown = np.zeros(tiny.train[0].mask.shape, bool)
    read = replace(tiny, train=tuple(replace(view, valid=unknown) for view in tiny.train))
    assert record(take(read, **clipped), CaptureSettings())["saturated_share"] == 0.0


# ---------------------------------------------------------------- geometry
def test_a_hull_needs_no_mesh_and_leaves_the_truth(tiny: Scene) -> None:
    settings = {"geometry": "hull", "cells": 40, "triangles": 1500}
    notes: list[str] = []
    after = captured(tiny, CaptureSettings(**settings), notes.append)  # type: ignore[arg-type]
    assert after.truth.mesh is tiny.mesh
    assert after.mesh_is_made
    again = captured(replace(tiny, mesh=None), CaptureSettings(**settings), notes.append)  # type: ignore[arg-type]
    assert len(notes) == 2  # that the given mesh is not used, and how the hull is made; the second one is from the cache
    np.testing.assert_array_equal(again.expect_mesh().vertices, after.expect_mesh().vertices)
    assert again.truth.mesh is None
    given, found = tiny.expect_mesh().vertices, after.expect_mesh().vertices
    np.testing.assert_allclose(found.max(0) - found.min(0), given.max(0) - given.min(0), atol=0.15)


def test_an_sdf_is_made_of_images_and_knows_no_truth(tiny: Scene) -> None:
    """The same with and without truth, from the cache the second time; another image is another mesh, of a hull the same."""
    settings = CaptureSettings(geometry="sdf", sdf=SdfSettings(cells=32, steps=2), triangles=1500)
    notes: list[str] = []
    after = captured(tiny, settings, notes.append)
    bare = captured(replace(tiny.blind(), mesh=None), settings, notes.append)
    assert len(notes) == 2
    np.testing.assert_array_equal(after.expect_mesh().vertices, bare.expect_mesh().vertices)
    assert after.mesh_is_made
    assert after.truth.mesh is tiny.mesh
    other = replace(tiny, train=(replace(tiny.train[0], image=2 * tiny.train[0].image), *tiny.train[1:]))
    captured(other, settings, notes.append)
    assert sum("from 16 training views" in note for note in notes) == 2
    hull = replace(settings, geometry="hull", cells=32)
    captured(tiny, hull, notes.append)
    captured(other, hull, notes.append)
    assert sum("from 16 training views" in note for note in notes) == 3
    turning = captured(tiny, replace(settings, light="camera"), notes.append)
    assert sum("from 16 training views" in note for note in notes) == 4
    assert not np.array_equal(turning.expect_mesh().vertices, after.expect_mesh().vertices)
    np.testing.assert_array_equal(turning.turning.start, turning.train[0].camera.to_world[:3])


@pytest.mark.slow
def test_cameras_move_with_their_photographs_where_they_may(tiny: Scene) -> None:
    """Training cameras alone, a little, and as much when the mesh comes from the cache; without ``align`` they stay."""
    sdf = SdfSettings(cells=32, steps=30, align=True)
    settings = CaptureSettings(geometry="sdf", sdf=sdf, triangles=1500)
    one, again = (captured(tiny, settings, lambda line: None) for _ in range(2))
    for before, view, same in zip(tiny.train, one.train, again.train, strict=True):
        np.testing.assert_array_equal(view.camera.to_world, same.camera.to_world)
        assert 0 < np.abs(view.camera.to_world - before.camera.to_world).max() < 0.1
        np.testing.assert_array_equal(view.image, before.image)
    assert all(a is b for a, b in zip(one.test, tiny.test, strict=True))
    stay = captured(tiny, replace(settings, sdf=replace(sdf, align=False)), lambda line: None)
    assert all(a.camera is b.camera for a, b in zip(stay.train, tiny.train, strict=True))


def test_smoothed_meshes_keep_their_textures(tiny: Scene) -> None:
    after = take(tiny, geometry="smoothed", smoothing=0.02).expect_mesh()
    np.testing.assert_array_equal(after.uv, tiny.expect_mesh().uv)
    moved = np.linalg.norm(after.vertices - tiny.expect_mesh().vertices, axis=1)
    assert 0.001 < moved.mean() < 0.1


@pytest.mark.parametrize("geometry", ["given", "smoothed"])
def test_a_mesh_that_is_not_there_is_told_with_what_to_do(tiny: Scene, geometry: str) -> None:
    with pytest.raises(InputError, match=f"capture.geometry={geometry}: expected a mesh.*found none; capture.geometry=hull"):
        take(replace(tiny, mesh=None), geometry=geometry)


def test_labels_of_a_named_choice_tell_what_differs_from_it() -> None:
    phone = shipped("phone")
    assert phone.label == "phone"
    assert replace(phone, views=8, geometry="hull", jpeg="none").label == "phone, 8 views, no jpeg, hull"
    assert replace(phone, name="mine", views=1).label.startswith("mine, 1 view, LDR")


def test_a_turning_light_is_captured_and_recorded(tiny: Scene) -> None:
    settings = CaptureSettings(light="turntable", turntable_axis=(0.0, 0.0, 1.0), views=4)
    after = take(tiny, light="turntable", turntable_axis=(0.0, 0.0, 1.0), views=4)
    told = record(after, settings)["turning"]
    places = np.stack([view.camera.position for view in after.train])
    around = np.degrees(np.arctan2(places[:, 1], places[:, 0]))
    assert np.abs((told["degrees"] - (around - around[0]) + 180) % 360 - 180).max() < 1e-2
    with pytest.raises(InputError, match="expected cameras beside the axis, found .* on it"):
        take(tiny, light="turntable", turntable_axis=tuple(map(float, tiny.train[2].camera.to_world[:3, 2])))
    assert TurningLight.of_record(told) == after.turning
    assert settings.label == "4 views, light turntable, axis 0 0 1"
    assert take(tiny).turning is None
