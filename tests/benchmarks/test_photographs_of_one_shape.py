"""Photographs of a ball that glows evenly, two of them black: what they tell of another is known by hand."""

import math

import numpy as np
import pytest
import torch
from shapes import camera_at, sphere

from benchmarks.photographs_of_one_shape import measured
from ia_bench.material.textures import Material
from ia_bench.render.reconstruction import TexturedReconstruction
from ia_bench.render.stage import Stage
from ia_bench.scenes.scene import View

AT = [(3.0 * math.cos(angle), 3.0 * math.sin(angle), 0.5) for angle in (0.0, 0.0, 1.0, -1.0)]
VALUE = 0.5
ENCODED = 1.055 * VALUE ** (1 / 2.4) - 0.055


def test_the_nearest_photograph_the_mean_of_all_and_a_black_render(own_cache: None) -> None:
    stage = Stage(sphere(3), torch.device("cpu"))
    views = []
    for number, (place, brightness) in enumerate(zip(AT, (1.0, 1.0, 0.0, 0.0), strict=True)):
        camera = camera_at(place, pixels=24)
        mask = stage.gbuffer([camera], 2).coverage()[0].numpy()
        views.append(View(f"{number}", camera, np.repeat(VALUE * brightness * mask[..., None], 3, -1).astype(np.float32), mask))
    black = TexturedReconstruction(stage, Material(torch.zeros(8, 8, 3), torch.ones(8, 8, 1)), torch.zeros(8, 16, 3), bounces=0)
    nearest, four, one_paint, render, holes, exposed = measured(views[0], views[1:], stage, black, 1.0)
    assert nearest > one_paint + 8  # but at the outline, which the first photograph sees too obliquely
    assert four == pytest.approx(one_paint)  # of three photographs
    assert one_paint < 16  # two of them are black
    assert render == pytest.approx(-20 * math.log10(ENCODED), abs=1e-4)
    assert holes == pytest.approx(render, abs=0.01)
    assert exposed == pytest.approx(render)
