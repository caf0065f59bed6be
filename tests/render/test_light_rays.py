"""What rays toward a scene's light meet, kept from one run to the next: pictures stay the same to the last bit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from shapes import bowl, camera_at

from ia_bench.common.cache import Cache, cache_folder
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.material.textures import Material
from ia_bench.render import light_rays, renderer
from ia_bench.render.reconstruction import Quality, TexturedReconstruction
from ia_bench.render.stage import Stage

CAMERAS = [camera_at((2.0, 1.0, 1.5), pixels=9), camera_at((-2.0, 1.0, 0.5), pixels=9)]
LIGHT = torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(1))


@pytest.fixture(autouse=True)
def several_passes(own_cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IA_BENCH_CACHE", str(tmp_path))
    monkeypatch.setattr(renderer, "CHUNK", 16)


def picture(seed: int, name: str = "sky", light: torch.Tensor = LIGHT, samples: int = 16) -> tuple[np.ndarray, int]:
    """One run's picture under a light, by a material of its own, and the shadow rays that it took; without a name none is kept."""
    draws = torch.Generator().manual_seed(seed)
    material = Material(torch.rand(8, 8, 3, generator=draws), torch.rand(8, 8, 1, generator=draws).clamp_min(0.3))
    stage = Stage(bowl(8), torch.device("cpu"))
    stage.apart.gbuffer(CAMERAS, 2), stage.apart.renderer(bounces=4)
    before = stage.apart.rays.rays
    found = TexturedReconstruction(stage, material, None)
    drawn = found.render(CAMERAS, light=LatLongEnvironment(light, name), albedo_scale=None, quality=Quality(2, samples, 3))
    return np.stack(drawn.images), stage.apart.rays.rays - before


def kept() -> list[str]:
    return [path.stem for path in cache_folder().glob("light-rays-*")]


def test_another_run_traces_only_what_its_own_material_decides() -> None:
    expected, rays = picture(2, name="")
    assert kept() == []
    picture(1)
    assert len(kept()) == 1
    found, fewer = picture(2)
    np.testing.assert_array_equal(found, expected)
    assert fewer < 0.7 * rays
    for changed in ({"light": LIGHT.flip(0)}, {"samples": 32}):
        np.testing.assert_array_equal(picture(2, **changed)[0], picture(2, name="", **changed)[0])
    assert len(kept()) == 3


@pytest.mark.parametrize("spoiled", ["checksums", "passes"])
def test_what_was_kept_of_other_directions_is_not_used(spoiled: str) -> None:
    """From the second pass on, as of a view that another processor sees a pixel more of; or passes are missing."""
    expected, _ = picture(1)
    (key,) = kept()
    good = Cache().get(key)[0]
    bad = {name: values.clone() for name, values in good.items()}
    if spoiled == "checksums":
        bad["checksums"][1:] += 1
        bad["blocked"][1:] = ~bad["blocked"][1:]
    else:
        bad = {name: values[:1].clone() for name, values in good.items()}
    Cache().put(key, bad)
    np.testing.assert_array_equal(picture(1)[0], expected)
    again = Cache().get(key)[0]
    assert {name: values.tolist() for name, values in again.items()} == {name: values.tolist() for name, values in good.items()}


def test_a_picture_in_which_nothing_is_seen_is_black_and_too_large_ones_are_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = camera_at((2.0, 1.0, 1.5), pixels=9)
    beside = camera.to_world.copy()
    beside[:3, 3] += 100 * beside[:3, 0]
    away = [replace(camera, to_world=beside)]
    found = TexturedReconstruction(Stage(bowl(8), torch.device("cpu")), Material(torch.ones(8, 8, 3), torch.ones(8, 8, 1)), None)
    drawn = found.render(away, light=LatLongEnvironment(LIGHT, "sky"), albedo_scale=None, quality=Quality(2, 16, 3))
    assert not np.stack(drawn.images).any()
    assert kept() == []
    monkeypatch.setattr(light_rays, "MOST_BYTES", 0)
    picture(1)
    assert kept() == []
