"""The numpy parts of the scene recipes: lights, cameras, rounding, views. Compared with closed forms and brute force.

What needs Blender is checked by `datasets/recipes/check_conventions.py`.
"""

import importlib
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import trimesh

ROOT = Path(__file__).resolve().parents[2]
RECIPES = ROOT / "datasets" / "recipes"

HEIGHT = 256
TRAINING_LIGHTS = ("garden", "harbour", "lamp_room", "spotlight", "snowfield", "workshop", "balcony", "cellar")
NOVEL_LIGHTS = ("studio", "sunset", "night")
SUNS = ("harbour", "spotlight", "snowfield", "balcony", "cellar", "sunset")
"""Lights with one small source that is hundreds of times brighter than anything else."""


def load(name: str) -> ModuleType:
    """A module of the recipes, which are scripts beside each other, not a package."""
    sys.path.insert(0, str(RECIPES))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(RECIPES))


latlong, lights, light_parts, cameras, exr, mesh, passes, recipe, scene_folder, staging = (
    load(name)
    for name in (
        "latlong", "lights", "light_parts", "cameras", "exr", "mesh", "passes", "recipe", "scene_folder", "staging"
    )  # fmt: skip
)


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


def test_direction_to_texel_inverts_texel_directions() -> None:
    row, column = latlong.direction_to_texel(latlong.texel_directions(37), 37)
    np.testing.assert_array_equal(row, np.arange(37)[:, None] * np.ones(74, int))
    np.testing.assert_array_equal(column, np.arange(74)[None] * np.ones((37, 1), int))


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


def test_rasterise_refuses_negative_radiance() -> None:
    with pytest.raises(ValueError, match="non-negative, got minimum -1"):
        latlong.rasterise(lambda d: -np.ones_like(d), 8, 0.6)


# -- lights ------------------------------------------------------------------------------------------------------------
def test_there_are_eight_training_and_three_novel_lights() -> None:
    assert set(lights.MODELS) == {*TRAINING_LIGHTS, *NOVEL_LIGHTS}
    assert {r.light for r in recipe.RECIPES.values()} == set(TRAINING_LIGHTS)
    with pytest.raises(ValueError, match="light must be one of garden, .* got 'moon'"):
        lights.make_light("moon", 8)


@pytest.mark.parametrize("name", [*TRAINING_LIGHTS, *NOVEL_LIGHTS])
def test_stored_lights_are_normalised_and_structured(name: str, rendered_lights: dict[str, np.ndarray]) -> None:
    light = rendered_lights[name]
    assert light.shape == (HEIGHT, 2 * HEIGHT, 3)
    assert light.min() > 0
    assert light.max() < exr.HALF_MAX / 10
    assert latlong.mean_luminance(light) == pytest.approx(lights.BRIGHTNESS, rel=2e-3)
    assert len(np.unique(light)) > 300  # no plain constants


@pytest.mark.parametrize("name", SUNS)
def test_small_sources_span_several_texels(name: str, rendered_lights: dict[str, np.ndarray]) -> None:
    luminance = rendered_lights[name].astype(float) @ latlong.LUMINANCE
    assert luminance.max() > 500 * np.median(luminance)
    core = luminance > luminance.max() / 2
    rows, columns = np.nonzero(core)
    assert 4 <= np.ptp(rows) + 1 <= 10
    directions = latlong.texel_directions(HEIGHT)[core]
    diameter = 2 * np.degrees(np.arccos(np.clip(directions @ directions.mean(axis=0), -1, 1)).max())
    assert 3.0 < diameter < 7.5


def test_the_lamp_room_is_yellow(rendered_lights: dict[str, np.ndarray]) -> None:
    light = rendered_lights["lamp_room"].astype(float)
    red, green, blue = (light * latlong.solid_angles(HEIGHT)[..., None]).sum(axis=(0, 1))
    assert red > green > 2.5 * blue
    assert (light[..., 2] < 0.5 * light[..., 0]).all()


def test_the_workshop_is_orange_but_for_a_cool_window(rendered_lights: dict[str, np.ndarray]) -> None:
    """A cast as strong as the lamp room's is another one, and is not in every direction."""
    light = rendered_lights["workshop"].astype(float)
    red, green, blue = (light * latlong.solid_angles(HEIGHT)[..., None]).sum(axis=(0, 1))
    assert 2.5 * blue < red < 3.5 * blue
    assert 1.6 * green < red  # the lamp room: 1.4
    luminance = light @ latlong.LUMINANCE * latlong.solid_angles(HEIGHT)
    cool = light[..., 2] > light[..., 0]
    assert 0.05 < luminance[cool].sum() / luminance.sum() < 0.25


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
    parts = light_parts.split(light)
    assert len(parts) == 1 + sources
    np.testing.assert_array_equal(sum((part > 0).any(axis=-1).astype(int) for part in parts), 1)
    np.testing.assert_array_equal(np.sum(parts, axis=0), light)


def test_a_light_without_bright_sources_is_one_part() -> None:
    light = np.ones((8, 16, 3), np.float16)
    (part,) = light_parts.split(light)
    np.testing.assert_array_equal(part, light)


def test_passes_of_parts_add_radiance_and_average_geometry_over_samples() -> None:
    """Combined from parts of 1 and 3 samples: by hand."""
    rng = np.random.default_rng(2)
    channels = {"rgba": (4,), "specular": (3,), "albedo": (3,), "normal": (3,), "roughness": (), "depth": ()}
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


def test_straight_up_is_refused() -> None:
    with pytest.raises(ValueError, match="off the z axis"):
        cameras.camera_to_world(np.array([0.0, 0.0, 3.0]))
    with pytest.raises(ValueError, match="got 'validation'"):
        cameras.split_poses("validation", 3)


# -- rounding ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("bits", [6, 8, 10])
def test_rounding_error_is_bounded_and_nearest(bits: int) -> None:
    rng = np.random.default_rng(0)
    values = (rng.choice([-1, 1], 50_000) * 2.0 ** rng.uniform(-14, 15.9, 50_000)).astype(np.float32)
    rounded = exr.round_mantissa(values, bits)
    error = np.abs(rounded.astype(np.float64) - values)
    assert (error <= 2.0 ** -(bits + 1) * np.abs(values)).all()
    # Independent: round the significand that frexp gives, half to even.
    significand, exponent = np.frexp(values.astype(np.float64))
    np.testing.assert_array_equal(
        rounded.astype(np.float64), np.ldexp(np.rint(significand * 2 ** (bits + 1)) / 2 ** (bits + 1), exponent)
    )


def test_rounding_keeps_zero_and_is_idempotent() -> None:
    values = np.concatenate([np.zeros(3), np.geomspace(1e-9, 6e4, 5000)]).astype(np.float32)
    rounded = exr.round_mantissa(values, 8)
    assert (rounded[:3] == 0).all()
    np.testing.assert_array_equal(exr.round_mantissa(rounded, 8), rounded)
    assert (np.abs(rounded.astype(float) - values) <= 2.0**-9 * values + 2.0**-25).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, 7e4])
def test_rounding_refuses_what_a_half_cannot_hold(bad: float) -> None:
    with pytest.raises(ValueError, match=r"finite and below 65504"):
        exr.round_mantissa(np.array([1.0, bad]), 8)


def test_normals_are_stored_in_absolute_steps() -> None:
    normal = np.random.default_rng(3).normal(size=(500, 1, 3))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    stored = exr.quantise(normal.astype(np.float32), exr.STORAGE["normal"]).astype(np.float64)
    np.testing.assert_array_equal(stored * 256, np.rint(stored * 256))
    assert np.abs(stored - normal).max() <= 1 / 512 + 1e-7


@pytest.mark.parametrize(("kind", "decibels"), [("image", 45.0), ("specular", 45.0), ("train_specular", 40.0)])
def test_lossy_kinds_keep_their_promise(tmp_path: Path, kind: str, decibels: float) -> None:
    """A shaded ball with texture, highlight and a hard edge: PSNR of gamma-encoded values; alpha is only rounded."""
    x, y = np.meshgrid(np.linspace(-1.1, 1.1, 96), np.linspace(-1.1, 1.1, 96))
    inside = x**2 + y**2 < 1
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    paint = 0.4 + 0.2 * np.sin(9 * x) * np.sin(7 * y) + np.random.default_rng(4).normal(0, 0.02, x.shape)
    shade = inside * (paint * np.maximum(0.3 * x + 0.9 * z, 0) + 2 * np.maximum(0.6 * x + 0.8 * z, 0) ** 60)
    image = np.stack([shade, 0.8 * shade, 0.5 * shade, inside], axis=-1)[..., : 4 if kind == "image" else 3]
    exr.store(tmp_path / "image.exr", image, kind)
    planes = exr.read_planes(tmp_path / "image.exr")
    found = np.stack([planes[c] for c in "RGB"], axis=-1).astype(np.float64)
    error = np.clip(found, 0, 1)[inside] ** (1 / 2.2) - np.clip(image[..., :3], 0, 1)[inside] ** (1 / 2.2)
    assert -10 * np.log10(np.mean(error**2)) > decibels
    if kind == "image":
        np.testing.assert_array_equal(planes["A"], image[..., 3])


def test_exr_round_trip(tmp_path: Path) -> None:
    image = exr.round_mantissa(np.random.default_rng(1).uniform(0, 2, (31, 37, 4)), 7)
    exr.write_exr(tmp_path / "deep" / "image.exr", image)
    planes = exr.read_planes(tmp_path / "deep" / "image.exr")
    np.testing.assert_array_equal(np.stack([planes[c] for c in "RGBA"], axis=-1), image)
    assert [p.name for p in (tmp_path / "deep").iterdir()] == ["image.exr"]  # no temporary file stays
    with pytest.raises(ValueError, match=r"expected a half image .* got float32"):
        exr.write_exr(tmp_path / "image.exr", np.zeros((3, 4, 3), np.float32))


# -- scene folder ------------------------------------------------------------------------------------------------------
def test_every_view_has_its_own_files_and_only_test_has_all_truth() -> None:
    views = scene_folder.views(recipe.RECIPES["hat"])
    assert len(views) == 100 + 20 + 20 * 4 + 4
    files = [path for view in views for path in view.files]
    assert len(set(files)) == len(files) == 100 * 2 + 20 * 6 + 80 + 4
    assert {v.light for v in views if v.split == "novel"} == {"train", *NOVEL_LIGHTS}
    assert all(v.light == "train" for v in views if v.split != "novel")
    direct, test = ([v for v in views if v.split == split] for split in ("direct", "test"))
    assert [v.image for v in direct] == [f"direct/test/{index:04d}.exr" for index in (0, 5, 10, 15)]
    assert all((v.pose == test[v.index].pose).all() for v in direct)


def test_larger_images_get_larger_textures() -> None:
    hat = recipe.RECIPES["hat"]
    assert hat.at_size(128) == hat
    assert (hat.at_size(512).size, hat.at_size(512).texture_size) == (512, 2048)
    assert hat.at_size(64).texture_size == hat.texture_size


# -- staging -----------------------------------------------------------------------------------------------------------
def test_a_finished_render_replaces_the_scene_and_leaves_nothing_else(tmp_path: Path) -> None:
    out, hat = tmp_path / "hat", recipe.RECIPES["hat"]
    (out / "images").mkdir(parents=True)
    (out / "images" / "old.exr").touch()
    folder = staging.begin(out, hat)
    assert staging.begin(out, hat) == folder  # resumed
    for name in ("new.exr", ".new.123.exr", ".lock"):
        (folder / name).touch()
    assert (out / "images" / "old.exr").exists()  # untouched until the new one is complete
    staging.publish(folder, out)
    assert [path.name for path in tmp_path.rglob("*")] == ["hat", "new.exr"]


def test_an_unfinished_render_of_something_else_is_refused(tmp_path: Path) -> None:
    staging.begin(tmp_path / "hat", recipe.RECIPES["hat"])
    with pytest.raises(ValueError, match=r"unfinished render with texture_size 512, size 128|unfinished render with size 128"):
        staging.begin(tmp_path / "hat", recipe.RECIPES["hat"].at_size(512))
    staging.begin(tmp_path / "ship", recipe.RECIPES["hat"].at_size(512))  # another place is free


def make_scenes(*settings: str) -> list[list[str]]:
    """What `make scenes` would run for each scene, as arguments of render_scene.py; nothing is run."""
    printed = subprocess.run(
        ["make", "-n", "scenes", *settings], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.replace("\\\n", "")
    (loop,) = (line for line in printed.splitlines() if "render_scene.py" in line)
    listed, _, command = loop.removeprefix("for scene in ").partition("; do")
    arguments = command.split("render_scene.py")[1].split("||")[0]
    return [arguments.replace("$scene", name).split() for name in listed.split()]


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
def test_make_scenes_leaves_the_shipped_scenes_alone() -> None:
    four = ("hat", "ship", "console", "figurine")
    assert make_scenes() == [[name, "--out", f"results/datasets/scenes/{name}"] for name in four]
    assert make_scenes("SIZE=512") == [
        [name, "--size", "512", "--out", f"results/datasets-512/scenes/{name}"] for name in four
    ]
    assert make_scenes("SCENES=tiny") == [["tiny", "--out", "results/datasets/scenes/tiny"]]  # at its own size
    assert make_scenes("SCENES=hat", "DATASETS=elsewhere") == [["hat", "--out", "elsewhere/scenes/hat"]]


# -- mesh --------------------------------------------------------------------------------------------------------------
def test_ply_round_trip(tmp_path: Path) -> None:
    """Also through trimesh, which knows nothing of this writer."""
    rng = np.random.default_rng(6)
    corners = rng.normal(size=(50, 8)).astype(np.float32)
    faces = rng.permuted(np.tile(np.arange(50, dtype=np.int32), (40, 1)), axis=1)[:, :3]
    written = mesh.Mesh(corners[:, :3], corners[:, 3:6], corners[:, 6:], faces)
    mesh.write_ply(tmp_path / "mesh.ply", written)
    read = mesh.read_ply(tmp_path / "mesh.ply")
    for name in ("positions", "normals", "uv", "faces"):
        np.testing.assert_array_equal(getattr(read, name), getattr(written, name))
    other = trimesh.load(tmp_path / "mesh.ply", process=False)
    np.testing.assert_array_equal(other.vertices[other.faces], corners[faces, :3])  # it may number vertices otherwise
    with pytest.raises(ValueError, match="at most 65536 vertices, got 65537"):
        mesh.write_ply(tmp_path / "mesh.ply", mesh.Mesh(*(np.zeros((65537, n), np.float32) for n in (3, 3, 2)), faces))
