"""The numpy parts of the scene recipes: lights, cameras, rounding, views. Compared with closed forms and brute force.

What needs Blender is checked by `datasets/recipes/check_conventions.py`.
"""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
import yaml
from recipe_modules import NOVEL_LIGHTS, ROOT, cameras, exr, latlong, light_parts, lights, passes, real, recipe, scene_folder

HEIGHT = 128
TRAINING_LIGHTS = ("garden", "harbour", "lamp_room", "spotlight", "snowfield", "workshop", "balcony", "cellar")
"""Lights with one small source that is hundreds of times brighter than anything else."""


@pytest.fixture(scope="module")
def rendered_lights() -> dict[str, np.ndarray]:
    """Every light at full resolution, as it is stored."""
    return {name: exr.round_mantissa(lights.make_light(name, HEIGHT), 8) for name in lights.MODELS}


# -- lat-long ----------------------------------------------------------------------------------------------------------
def test_texels_look_along_their_axes() -> None:
    """Frozen convention: row 0 is up; the middle column looks along +x, a quarter to its left along +y."""
    directions = latlong.texel_directions(64)
    tolerance = np.pi / 64
    np.testing.assert_allclose(directions[0].mean(axis=0), (0, 0, 1), atol=1e-2)
    np.testing.assert_allclose(directions[32, 64], (1, 0, 0), atol=tolerance)
    np.testing.assert_allclose(directions[32, 32], (0, 1, 0), atol=tolerance)
    np.testing.assert_allclose(directions[32, 96], (0, -1, 0), atol=tolerance)
    np.testing.assert_allclose(directions[32, 0], (-1, 0, 0), atol=tolerance)


def test_solid_angles_cover_the_sphere_and_match_the_sine() -> None:
    omega = latlong.solid_angles(37)
    assert omega.sum() * 74 == pytest.approx(4 * np.pi, rel=1e-12)
    theta = np.pi * (np.arange(37) + 0.5) / 37
    np.testing.assert_allclose(omega[5:-5, 0], (np.sin(theta) * (np.pi / 37) ** 2)[5:-5], rtol=1e-3)


def test_mean_luminance_is_what_a_white_diffuse_sphere_averages() -> None:
    """Brute force: radiosity / pi of a Lambertian sphere, averaged over its normals, under a one-sided light."""
    directions = latlong.texel_directions(24)
    light = np.repeat(1 + 5 * np.maximum(directions @ np.array([0.6, 0.0, 0.8]), 0)[..., None], 3, axis=-1)
    weights = (latlong.solid_angles(24) * np.ones(48)).ravel()
    cosines = np.maximum(directions.reshape(-1, 3) @ directions.reshape(-1, 3).T, 0)
    radiosity = cosines @ (weights * light[..., 0].ravel()) / np.pi
    assert latlong.mean_luminance(light) == pytest.approx((radiosity * weights).sum() / weights.sum(), rel=0.01)


# -- lights ------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", [*TRAINING_LIGHTS, *NOVEL_LIGHTS])
def test_stored_lights_are_normalised_and_structured(name: str, rendered_lights: dict[str, np.ndarray]) -> None:
    light = rendered_lights[name]
    assert light.shape == (HEIGHT, 2 * HEIGHT, 3)
    assert light.min() > 0
    assert light.max() < exr.HALF_MAX / 10
    assert latlong.mean_luminance(light) == pytest.approx(lights.BRIGHTNESS, rel=2e-3)
    assert len(np.unique(light)) > 300  # no plain constants


def test_lights_do_not_depend_on_resolution() -> None:
    coarse, fine = lights.make_light("harbour", 32), lights.make_light("harbour", 64)
    pooled = fine.reshape(32, 2, 64, 2, 3).mean(axis=(1, 3))
    mask = pooled.max(axis=-1) < 3  # away from the sun's rim
    assert mask.mean() > 0.95
    assert np.abs(coarse - pooled)[mask].mean() < 0.05 * pooled[mask].mean()


# -- parts of a light --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "sources"),
    [("garden", 1), ("harbour", 1), ("lamp_room", 5), ("workshop", 4), ("balcony", 1), ("cellar", 1), ("studio", 3), ("night", 7)],
)
def test_parts_of_a_light_partition_it(name: str, sources: int, rendered_lights: dict[str, np.ndarray]) -> None:
    """One part per lamp, sign, sun or moon of the light's model, and the rest; no texel twice, none lost."""
    light = rendered_lights[name]
    parts = light_parts.split(light, 0.01)
    assert len(parts) == 1 + sources
    np.testing.assert_array_equal(sum((part > 0).any(axis=-1).astype(int) for part in parts), 1)
    np.testing.assert_array_equal(np.sum(parts, axis=0), light)


def test_passes_of_parts_add_radiance_and_average_geometry_over_samples() -> None:
    """Combined from parts of 1 and 3 samples: by hand."""
    rng = np.random.default_rng(2)
    channels = {"rgba": (4,), "specular": (3,), "albedo": (3,), "normal": (3,), "roughness": (), "metallic": (), "depth": ()}
    shapes = {name: (3, 4, *last) for name, last in channels.items()}
    a, b = ({name: rng.random(shape).astype(np.float32) for name, shape in shapes.items()} for _ in range(2))
    whole = passes.combine([passes.Passes(**a), passes.Passes(**b)], [1, 3])
    np.testing.assert_allclose(whole.rgba[..., :3], a["rgba"][..., :3] + b["rgba"][..., :3], rtol=1e-6)
    np.testing.assert_allclose(whole.specular, a["specular"] + b["specular"], rtol=1e-6)
    np.testing.assert_allclose(whole.rgba[..., 3], 0.25 * a["rgba"][..., 3] + 0.75 * b["rgba"][..., 3], rtol=1e-6)
    for name in ("albedo", "normal", "roughness", "depth"):
        np.testing.assert_allclose(getattr(whole, name), 0.25 * a[name] + 0.75 * b[name], rtol=1e-6)


def test_connected_regions_match_a_flood_fill() -> None:
    rng = np.random.default_rng(5)
    texels = rng.random((13, 27)) < 0.35
    labels = light_parts.connected(texels)
    assert ((labels > 0) == texels).all()
    regions = set()
    for start in zip(*np.nonzero(texels), strict=True):
        region, queue = {start}, [start]
        while queue:
            row, column = queue.pop()
            around = [(row + i, (column + j) % 27) for i in (-1, 0, 1) for j in (-1, 0, 1) if 0 <= row + i < 13]
            new = [texel for texel in around if texels[texel] and texel not in region]
            region.update(new)
            queue += new
        regions.add(frozenset(region))
    assert labels.max() == len(regions)
    for region in regions:
        (label,) = {labels[texel] for texel in region}
        assert (labels == label).sum() == len(region)


# -- cameras -----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("split", "count"), [("train", 100), ("test", 20), ("novel", 20), ("train", 16)])
def test_poses_are_rigid_and_frame_the_unit_sphere(split: str, count: int) -> None:
    poses = cameras.split_poses(split, count)
    rotation, position = poses[:, :3, :3], poses[:, :3, 3]
    np.testing.assert_allclose(rotation @ rotation.transpose(0, 2, 1), np.tile(np.eye(3), (count, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotation), 1, atol=1e-12)
    assert (rotation[:, 2, 1] > 0).all()  # z is up in the image
    # Every point of the unit sphere projects into the frame, which it nearly fills.
    sphere = latlong.texel_directions(24).reshape(-1, 3)
    local = np.einsum("nji,pnj->npi", rotation, sphere[:, None] - position)
    extent = np.abs(local[..., :2] / -local[..., 2:]).max() / np.tan(cameras.FIELD_OF_VIEW / 2)
    assert local[..., 2].max() < 0
    assert 0.95 < extent <= 1.0


def test_elevations_cover_the_band_and_no_two_cameras_coincide() -> None:
    train, test, novel = (cameras.split_poses(s, n)[:, :3, 3] for s, n in (("train", 100), ("test", 20), ("novel", 20)))
    elevations = np.degrees(np.arcsin(train[:, 2] / cameras.DISTANCE))
    assert elevations.min() == pytest.approx(-25, abs=2)
    assert elevations.max() == pytest.approx(80, abs=5)
    positions = np.concatenate([train, test, novel]) / cameras.DISTANCE
    cosines = positions @ positions.T - 2 * np.eye(len(positions))
    assert np.degrees(np.arccos(cosines.max())) > 1.0


def test_scans_are_the_objects_and_lights_that_are_closed_to_training() -> None:
    closed = tomllib.loads((ROOT / "datasets" / "real" / "sources.toml").read_text())["closed"]
    (files,) = (entry["files"] for entry in closed if entry.get("set") == "scans")
    scans = {name: each for name, each in recipe.RECIPES.items() if each.scanned}
    lights_of = {f"lights/{name.removeprefix('real_')}.hdr" for each in scans.values() for name in each.lights.values()}
    assert {each.object for each in scans.values()} | lights_of == set(files)
    table = yaml.safe_load((ROOT / "conf" / "table" / "scans.yaml").read_text())
    assert set(table["scenes"]) == set(scans)
    named = re.search(r"^SCANS := (.+)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert set(named[1].split()) == set(scans)


def test_views_of_metal_have_its_truth() -> None:
    def kinds(name: str) -> set[str]:
        return {kind for view in scene_folder.views(recipe.RECIPES[name]) if view.split == "test" for kind in view.truth}

    assert kinds("egyptian_cat") == kinds("avocado") | {"metallic"}


def test_a_missing_real_file_is_told_with_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(real, "FOLDER", tmp_path)
    with pytest.raises(ValueError, match="expected a file of `make real-data`"):
        real.real_file("objects/gltf/avocado.glb")
