"""Views of several sizes as views of one: pixels keep their rays, and what is added says that nobody knows it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ia_bench.render.gbuffer import primary_rays
from ia_bench.scenes.padding import of_one_size
from ia_bench.scenes.scene import Scene, View


def cropped(view: View, height: int, width: int) -> View:
    """The upper left part of a view, as a photograph of its own."""
    arrays = {name: array[:height, :width] for name, array in vars(view).items() if isinstance(array, np.ndarray)}
    return replace(view, camera=replace(view.camera, height=height, width=width), **arrays)


def test_views_of_one_size_stay_the_very_same(tiny: Scene) -> None:
    assert all(kept is view for kept, view in zip(of_one_size(tiny.train), tiny.train, strict=True))


def test_what_was_seen_stays_and_the_rest_is_unknown(tiny: Scene) -> None:
    low, narrow = cropped(tiny.test[0], 25, 32), cropped(tiny.test[1], 32, 19)
    padded = of_one_size([low, narrow])
    for before, after in zip((low, narrow), padded, strict=True):
        height, width = before.mask.shape
        assert after.mask.shape == (after.camera.height, after.camera.width) == (32, 32)
        for name in ("image", "mask", "albedo", "roughness"):
            np.testing.assert_array_equal(getattr(after, name)[:height, :width], getattr(before, name))
        outside = np.ones((32, 32), bool)
        outside[:height, :width] = False
        assert after.valid is not None
        np.testing.assert_array_equal(after.valid, ~outside)
        assert not after.mask[outside].any()
        assert not after.image[outside].any()
        rays = primary_rays(after.camera, 1)[1][:height, :width]
        np.testing.assert_array_equal(rays, primary_rays(before.camera, 1)[1])


def test_saturated_pixels_stay_so(tiny: Scene) -> None:
    view = cropped(replace(tiny.train[0], valid=np.indices((32, 32))[0] > 3), 32, 20)
    after = of_one_size([view, tiny.train[1]])[0]
    assert after.valid is not None
    assert not after.valid[:4].any()
    assert after.valid[4:, :20].all()
    assert not after.valid[:, 20:].any()
