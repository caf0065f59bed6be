"""Faults of a capture and what puts them right."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from shapes import wrong_by

from ia_bench.capture.capture import captured
from ia_bench.capture.faults import blurred, misplaced, mistaken_masks, spread_over_directions
from ia_bench.capture.radiometry import through_jpeg
from ia_bench.capture.settings import CaptureSettings, FaultSettings
from ia_bench.common.errors import InputError
from ia_bench.geometry.consistency import seen_at
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.scene import Scene


# ---------------------------------------------------------------- faults of a capture
# Each does what its setting says, by what is measured of it independently, and leaves the rest alone.
def take(scene: Scene, faults: dict[str, Any] | None = None, **settings: Any) -> Scene:
    return captured(scene, CaptureSettings(faults=FaultSettings(**faults or {}), **settings), lambda line: None)


def test_poses_move_the_object_by_as_many_pixels(tiny: Scene) -> None:
    points, many = tiny.expect_mesh().vertices, []
    for seed in range(12):
        cameras = misplaced(tiny.train, FaultSettings(poses=0.8, seed=seed))
        many += [seen_at(c, points) - seen_at(v.camera, points) for c, v in zip(cameras, tiny.train, strict=True)]
    assert np.sqrt(np.mean([(apart**2).sum(-1).mean() for apart in many])) == pytest.approx(0.8, rel=0.1)
    assert np.linalg.norm(np.mean(many, axis=(0, 1))) < 0.15  # to no side more than to another
    for camera in cameras:
        np.testing.assert_allclose(camera.to_world[:3, :3] @ camera.to_world[:3, :3].T, np.eye(3), atol=1e-7)


def test_masks_grow_by_as_many_pixels(tiny: Scene) -> None:
    """A disc whose area tells its radius."""
    rows, columns = np.indices((96, 96)) - 47.5
    disc = (12.5 - np.hypot(rows, columns)).clip(0, 1).astype(np.float32)
    view = replace(tiny.train[0], mask=disc, image=np.zeros((96, 96, 3), np.float32))
    for growth in (-3.0, 1.0, 2.5):
        (mask,) = mistaken_masks([view], FaultSettings(mask_growth=growth))
        assert np.sqrt(mask.sum() / np.pi) == pytest.approx(12 + growth, abs=0.1)
    many = [replace(view, name=str(n)) for n in range(60)]
    radii = [np.sqrt(mask.sum() / np.pi) for mask in mistaken_masks(many, FaultSettings(mask_jitter=2))]
    assert 9.9 < min(radii) < 10.5
    assert 13.5 < max(radii) < 14.1
    assert np.mean(radii) == pytest.approx(12, abs=0.4)
    unknown = replace(view, valid=disc > 0)
    (mask,) = mistaken_masks([unknown], FaultSettings(mask_growth=4))
    assert not mask[disc == 0].any()  # what nobody knows is not masked in
    with pytest.raises(InputError, match="expected to leave a part of its mask"):
        mistaken_masks([view], FaultSettings(mask_growth=-14))


def test_as_many_views_are_blurred_and_masked_wrongly_as_asked(tiny: Scene) -> None:
    softer = blurred(tiny.train, FaultSettings(blurred_views=2, blur=1.5))
    changed = [n for n, (a, b) in enumerate(zip(softer, tiny.train, strict=True)) if a is not b]
    assert len(changed) == 2
    for n in changed:
        assert np.square(np.diff(softer[n].image, axis=0)).sum() < 0.5 * np.square(np.diff(tiny.train[n].image, axis=0)).sum()
        assert softer[n].image.sum() == pytest.approx(tiny.train[n].image.sum(), rel=0.02)
    halves = take(tiny, {"wrong_masks": 1}).train
    shares = sorted(a.mask.sum() / b.mask.sum() for a, b in zip(halves, tiny.train, strict=True))
    assert 0.3 < shares[0] < 0.7
    assert shares[1] == 1
    with pytest.raises(InputError, match=r"capture.faults.blurred_views=17: expected at most 16"):
        take(tiny, {"blurred_views": 17})


def test_faults_belong_to_photographs(tiny: Scene) -> None:
    """A photograph's own faults are the same beside others, repeat, and differ with the seed."""
    faults = FaultSettings(poses=1, mask_jitter=1)
    all_of_them, few = take(tiny, {"poses": 1.0, "mask_jitter": 1.0}).train, tiny.train[3:5]
    np.testing.assert_array_equal(mistaken_masks(few, faults)[1], all_of_them[4].mask)
    again = take(tiny, {"poses": 1.0, "mask_jitter": 1.0}).train
    other = take(tiny, {"poses": 1.0, "mask_jitter": 1.0, "seed": 1}).train
    np.testing.assert_array_equal(again[0].camera.to_world, all_of_them[0].camera.to_world)
    assert not np.allclose(other[0].camera.to_world, again[0].camera.to_world, atol=1e-6)
    only = take(tiny, {"poses": 1.0}).train
    np.testing.assert_array_equal(only[5].camera.to_world, all_of_them[5].camera.to_world)  # whatever the other faults are


def test_edges_mix_in_the_background_and_a_wide_mask_shows_it(tiny: Scene) -> None:
    before = tiny.train[0]
    level = float(
        np.percentile(np.concatenate([(v.image / v.mask.clip(1e-6)[..., None]).max(-1)[v.mask > 0.5] for v in tiny.train]), 98)
    )
    after = take(tiny, {"mask_growth": 1.5}, background=0.25).train[0]
    beside = (before.mask == 0) & (after.mask == 1)
    assert beside.sum() > 10
    np.testing.assert_allclose(after.image[beside], 0.25 * level, rtol=1e-4)
    edge = (before.mask > 0.2) & (before.mask < 0.8) & (after.mask == 1)
    mixed = before.image + 0.25 * level * (1 - before.mask[..., None])
    np.testing.assert_allclose(after.image[edge], mixed[edge], rtol=1e-4)
    alone = take(tiny, {"mask_growth": 1.5}).train[0]
    assert not alone.image[beside].any()


def test_jpeg_is_a_real_one(tiny: Scene) -> None:
    """Errors grow as the quality falls, and fine colour goes first: it is kept at half of the resolution."""
    view = tiny.train[0]
    codes = np.round(255 * linear_to_srgb((view.image / view.image.max()).clip(0, 1)))
    errors = [np.abs(through_jpeg(codes, quality) - codes).mean() for quality in (95, 70, 20)]
    assert 0.1 < errors[0] < errors[1] < errors[2] < 20
    grey, colours = np.full((32, 32, 3), 128.0), np.full((32, 32, 3), 128.0)
    grey[::2] = 160
    colours[::2] = [160, 128, 96]
    assert np.abs(through_jpeg(grey, 95) - grey).mean() < 3 < np.abs(through_jpeg(colours, 95) - colours).mean()
    after = take(tiny, radiometry="ldr", jpeg=90).train[0]
    known = (view.mask == 1) & after.valid
    assert 0 < np.abs(after.image - view.image)[known].mean() < 0.03 * view.image.max()


def test_a_margin_hides_edges(tiny: Scene) -> None:
    after = take(tiny, margin=2.0)
    for view, before in zip(after.train, tiny.train, strict=True):
        kept = view.mask > 0
        assert 0.4 < kept.sum() / before.mask.sum() < 0.9
        straight = before.image / before.mask.clip(1e-6)[..., None]
        np.testing.assert_allclose(view.image[kept], straight[kept], rtol=1e-6)
        assert not view.valid[~kept].any()
        assert not view.image[~kept].any()


# ---------------------------------------------------------------- poses and masks of a few photographs are made to agree
# Too: as many are doubted as leave a hull that is closed.
@pytest.mark.parametrize("count", [3, 5, 6, 8])
def test_wrong_poses_of_few_photographs_are_put_right(tiny: Scene, count: int) -> None:
    """What is still wrong after it is less than before, by the true cameras, which nothing that is made knows."""
    faults, notes = FaultSettings(poses=1.0), list[str]()
    true = spread_over_directions(tiny.train, count)
    spoiled = tuple(replace(v, camera=camera) for v, camera in zip(true, misplaced(true, faults), strict=True))
    after = captured(tiny, CaptureSettings(views=count, faults=faults, consistency=3), notes.append).train
    points = tiny.expect_mesh().vertices[::20]
    assert wrong_by(after, true, points) < 0.9 * wrong_by(spoiled, true, points)
    assert any("a hull that tolerates 3 views is open" in note for note in notes) == (count == 8)


def test_a_hull_that_stays_open_is_told_with_how_many_may_be_wrong(tiny: Scene) -> None:
    with pytest.raises(InputError, match=r"^masks: expected views from enough sides.*, found 2 views that leave it open; "):
        captured(tiny, CaptureSettings(views=2, consistency=1), lambda line: None)
    with pytest.raises(InputError, match=r"found 4 views that leave it open, 2 of which may be wrong \(capture\.tolerated\)"):
        captured(tiny, CaptureSettings(views=4, geometry="hull", tolerated=2), lambda line: None)


@pytest.mark.parametrize("settings", [CaptureSettings(geometry="hull"), CaptureSettings(consistency=1)])
def test_no_fewer_photographs_than_may_be_wrong(tiny: Scene, settings: CaptureSettings) -> None:
    asked = replace(settings, views=3, tolerated=3)
    with pytest.raises(InputError, match=r"^capture\.tolerated=3: expected fewer than the 3 photographs that are taken$"):
        captured(tiny, asked, lambda line: None)
    unread = CaptureSettings(views=3, tolerated=3)  # not refused where nothing reads it
    assert len(captured(tiny, unread, lambda line: None).train) == 3


def test_what_is_true_is_cut_out_as_the_pictures_are(tiny: Scene) -> None:
    for scene in (take(tiny, {"mask_growth": -2.0}), take(tiny, margin=3.0)):
        for view in scene.train:
            for name in ("albedo", "specular"):
                assert not getattr(view, name)[view.mask == 0].any()
    shrunk, whole = take(tiny, margin=3.0).train[0], tiny.train[0]
    inside = (shrunk.mask > 0) & (whole.mask == 1)
    np.testing.assert_array_equal(shrunk.albedo[inside], whole.albedo[inside])


def test_views_that_a_margin_would_leave_nothing_of_are_told(tiny: Scene) -> None:
    said: list[str] = []
    views = captured(tiny, CaptureSettings(margin=100.0), said.append).train
    assert said[-1].startswith("capture.margin=100: 16 of 16 views stay whole, of which it would leave nothing: ")
    assert all(np.array_equal(view.mask, before.mask) for view, before in zip(views, tiny.train, strict=True))


def test_recorded_exposures_are_divided_out_of_the_truth_too(tiny: Scene) -> None:
    factors = np.linspace(0.5, 2, len(tiny.train))
    shot = [
        replace(v, image=v.image * np.float32(f), specular=v.specular * f, exposure=f)
        for v, f in zip(tiny.train, factors, strict=True)
    ]
    found = take(replace(tiny, train=tuple(shot), test=(), novel=()))
    unit = np.exp(np.log(factors).mean())
    for view, before in zip(found.train, tiny.train, strict=True):
        np.testing.assert_allclose(view.image, before.image * unit, rtol=1e-5)
        np.testing.assert_allclose(view.specular, before.specular * unit, rtol=1e-5)
