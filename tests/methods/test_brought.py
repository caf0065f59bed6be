"""What other software made comes back as it is: an asset on its mesh, pictures view by view; and each mistake is one sentence."""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from spoils import exr, gone

from ia_bench.common.declared import Declared
from ia_bench.common.errors import InputError
from ia_bench.common.settings import parsed
from ia_bench.methods.asset import BroughtAsset
from ia_bench.methods.contract import Monitor, Problem, Result
from ia_bench.methods.images import BroughtImages
from ia_bench.methods.info import held_out
from ia_bench.render.asset_files import glb, moved
from ia_bench.render.reconstruction import Assets, Quality
from ia_bench.scenes.color import linear_to_srgb
from ia_bench.scenes.exr import read_exr, write_exr
from ia_bench.scenes.scene import Scene
from ia_bench.scores.protocol import Protocol
from ia_bench.scores.scorer import Scorer

SMALL = Protocol(map_points=2, render_points=2, samples_per_pixel=8)


def brought(scene: Scene, method: type, **options: Any) -> tuple[Result, list[str]]:
    """The result of a method on a scene, as a run would have it, and the notes."""
    notes = list[str]()
    problem = Problem(scene.blind(), held_out=held_out(scene))
    made = method(parsed(method.Options, options, "method.options"))
    return made.fit(problem, seed=0, monitor=Monitor.silent(note=notes.append)), notes


@pytest.fixture(scope="module")
def asset(scene: Scene) -> Assets:
    """The true one."""
    light = scene.truth.lights["train"].astype(np.float32)
    return Assets(scene.mesh, scene.truth.albedo.astype(np.float32), scene.truth.roughness.astype(np.float32), None, light)


@pytest.fixture(scope="module")
def files(asset: Assets, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("brought")
    (folder / "asset.glb").write_bytes(glb(asset.mesh, asset.albedo, asset.roughness))
    write_exr(folder / "light.exr", asset.light, half=False)
    return folder


@pytest.fixture
def pictures(scene: Scene, tmp_path: Path) -> Path:
    """The true pictures of every held-out view, in the folders of the method."""
    for folder, views in held_out(scene).items():
        light = {"view_synthesis": "train"}.get(folder, folder.partition("/")[2])
        of = {view.name: view for view in (scene.novel if light else scene.test) if not light or view.light == light}
        for name, _ in views:
            values = getattr(of[name], "image" if light else folder)
            colours = np.broadcast_to(np.atleast_3d(values), (*values.shape[:2], 3))
            write_exr(tmp_path / "pictures" / folder / f"{name}.exr", np.dstack([colours, of[name].mask]), half=False)
    return tmp_path / "pictures"


# ---- assets ----
def test_an_asset_comes_back_on_its_mesh_with_what_is_declared(scene: Scene, asset: Assets, files: Path) -> None:
    declared = {"authors": "Ada", "seconds": 12.5}
    paths = {"path": str(files / "asset.glb"), "light": str(files / "light.exr")}
    result, notes = brought(scene, BroughtAsset, **paths, declared=declared)
    found = result.reconstruction.assets()
    assert found.mesh.same_as(scene.mesh, uv=True)
    assert np.abs(found.albedo - asset.albedo).max() < 0.005
    np.testing.assert_array_equal(found.light, asset.light)
    assert result.declared == Declared(authors="Ada", seconds=12.5)
    assert any("intersection over union 0.9" in note or "intersection over union 1.0" in note for note in notes)


def test_icp_brings_a_moved_asset_back_and_tells_what_is_left(scene: Scene, asset: Assets, files: Path, tmp_path: Path) -> None:
    angle, scale = np.radians(6), 1.08
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = scale * turn, (0.04, -0.03, 0.05)
    away = moved(asset, matrix)
    (tmp_path / "away.glb").write_bytes(glb(away.mesh, away.albedo, away.roughness))
    result, notes = brought(scene, BroughtAsset, path=str(tmp_path / "away.glb"), align="icp")
    places = result.reconstruction.assets().mesh.vertices
    extent = np.ptp(scene.mesh.vertices, axis=0).max()
    assert np.abs(places - scene.mesh.vertices).max() < 0.01 * extent
    (said,) = [note for note in notes if "ICP" in note]
    assert float(re.search(r"points are ([\d.]+)%", said)[1]) < 1
    with pytest.raises(InputError, match=r"align=icp: expected a scene with a mesh"):
        brought(replace(scene, mesh=None), BroughtAsset, path=str(tmp_path / "away.glb"), align="icp")


def test_another_mesh_is_scored_by_its_pictures_and_its_shape(scene: Scene, asset: Assets, tmp_path: Path) -> None:
    """Half as many triangles would do: here every triangle of the scene, a little larger."""
    larger = moved(asset, np.diag([1.02, 1.02, 1.02, 1.0]))
    (tmp_path / "larger.glb").write_bytes(glb(larger.mesh, larger.albedo, larger.roughness))
    result, _ = brought(scene, BroughtAsset, path=str(tmp_path / "larger.glb"))
    scorer = Scorer(scene, SMALL, torch.device("cpu"))
    scores = scorer.full(result.reconstruction)
    diagonal = np.linalg.norm(np.ptp(scene.mesh.vertices, axis=0))
    away = 0.02 * np.linalg.norm(scene.mesh.vertices, axis=1).mean() / diagonal
    assert 0.1 * away < scores.geometry["chamfer"] < 2 * away
    assert scores.metrics["albedo"]["psnr"] is not None
    assert "does not predict view synthesis" in scores.reasons["view_synthesis.psnr"]


AXES = {
    "z up taken as y up": ({"up": "z"}, "with method.options.up=y it would be"),
    "mirrored": ({"matrix": ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, -1, 0), (0, 0, 0, 1))}, "[0,0,1,0]"),
    "far away": ({"matrix": ((1, 0, 0, 100), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))}, "matrix or align=icp"),
}


@pytest.mark.parametrize("case", AXES)
def test_axes_that_are_wrong_are_named_with_those_that_would_be_right(scene: Scene, files: Path, case: str) -> None:
    options, said = AXES[case]
    try:
        _, notes = brought(scene, BroughtAsset, path=str(files / "asset.glb"), **options)
    except InputError as error:
        notes = [str(error)]
    (warning,) = [note for note in notes if "expected the mesh to cover the masks" in note]
    assert str(files / "asset.glb") in warning
    assert said in warning


def test_a_matrix_that_moves_rows_is_refused_and_a_missing_light_told(scene: Scene, files: Path) -> None:
    transposed = ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0.1, 0, 0, 1))
    with pytest.raises(InputError, match=r"matrix: expected \[0, 0, 0, 1\] as its last row, found \[0.1, 0.0, 0.0, 1.0\]"):
        brought(scene, BroughtAsset, path=str(files / "asset.glb"), matrix=transposed)
    result, notes = brought(scene, BroughtAsset, path=str(files / "asset.glb"))
    cameras = [view.camera for view in scene.novel[:1]]
    assert result.reconstruction.render(cameras, light=None, albedo_scale=None, quality=Quality(1, 4)) is None
    assert any("no light, so view synthesis is undefined" in note for note in notes)


@pytest.mark.parametrize(("wound", "out"), [(-1, 1), (1, -1), (1, 1)])
def test_a_mesh_that_is_inside_out_is_told(scene: Scene, asset: Assets, tmp_path: Path, wound: int, out: int) -> None:
    """But at silhouettes, where a shading normal may point away from the camera whichever way all of them point."""
    mesh = replace(asset.mesh, faces=asset.mesh.faces[:, ::wound].copy(), normals=out * asset.mesh.normals)
    (tmp_path / "turned.glb").write_bytes(glb(mesh, asset.albedo, asset.roughness))
    _, notes = brought(scene, BroughtAsset, path=str(tmp_path / "turned.glb"))
    told = [note for note in notes if "counter-clockwise from outside" in note]
    percentages = [int(number) for number in re.findall(r"(\d+)%", " ".join(told))]
    expected = [] if wound == out else [100 * (wound < 0), 100]
    np.testing.assert_allclose(percentages, expected, atol=5)


# ---- pictures ----
def test_pictures_are_scored_as_they_are(scene: Scene, pictures: Path) -> None:
    result, notes = brought(scene, BroughtImages, path=str(pictures))
    assert notes == []
    scores = Scorer(scene, SMALL, torch.device("cpu")).full(result.reconstruction)
    for component, metric in (("albedo", "psnr"), ("view_synthesis", "psnr"), ("relighting", "psnr")):
        assert scores.metrics[component][metric] == np.inf
    assert scores.metrics["roughness"]["mse"] == 0
    assert scores.renderer == "pictures as they were brought"
    assert scores.geometry == {}


def test_each_folder_alone_is_scored(scene: Scene, pictures: Path) -> None:
    for folder in ("albedo", "roughness", "view_synthesis"):
        shutil.rmtree(pictures / folder)
    result, notes = brought(scene, BroughtImages, path=str(pictures))
    assert [note.partition("no folder ")[2].partition(",")[0] for note in notes] == ["albedo", "roughness", "view_synthesis"]
    scores = Scorer(scene, SMALL, torch.device("cpu")).full(result.reconstruction)
    assert scores.metrics["relighting"]["psnr"] == np.inf
    assert scores.reasons["albedo.psnr"] == "the method does not predict albedo"


@pytest.mark.parametrize("encoding", ["srgb", "linear"])
def test_png_is_decoded_as_declared(scene: Scene, pictures: Path, encoding: str) -> None:
    for path in (pictures / "albedo").iterdir():
        image = read_exr(path, 4)
        straight = image[..., :3] / image[..., 3:].clip(1e-6)
        encoded = linear_to_srgb(straight) if encoding == "srgb" else straight
        stored = np.round(255 * np.dstack([encoded, image[..., 3]]).clip(0, 1)).astype(np.uint8)
        Image.fromarray(stored).save(path.with_suffix(".png"))
        path.unlink()
    result, _ = brought(scene, BroughtImages, path=str(pictures), albedo_encoding=encoding)
    views = scene.test
    found = result.reconstruction.maps([view.camera for view in views], ["albedo"], points=1)["albedo"]
    for view, image in zip(views, found.images, strict=True):
        inside = view.mask > 0.5
        assert np.abs(image - view.albedo)[inside].max() < 0.02


def test_order_by_name_or_by_the_frames_of_a_file(scene: Scene, pictures: Path) -> None:
    names = [view.name for view in scene.test]
    order = {name: f"picture_{9 - place}" for place, name in enumerate(names)}  # by name they are in the reverse order
    for path in list((pictures / "albedo").iterdir()):
        path.rename(path.with_stem(order[path.stem]))
    for folder in ("roughness", "view_synthesis", "relighting"):
        (pictures / folder).rename(pictures.parent / f"{pictures.name}_{folder}")
    cameras = [view.camera for view in scene.test]
    (pictures / "t.json").write_text(json.dumps({"frames": [{"file_path": f"./x/{order[name]}.png"} for name in names]}))
    for said, first in ((str(pictures / "t.json"), 0), ("sorted", -1)):
        result, _ = brought(scene, BroughtImages, path=str(pictures), order=said)
        found = result.reconstruction.maps(cameras, ["albedo"], points=1)["albedo"]
        np.testing.assert_array_equal(found.images[0], scene.test[first].albedo)


def as_png(name: str, mode: str) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        Image.fromarray(np.full((32, 32, 3), 99, np.uint8)).convert(mode).save((folder / name).with_suffix(".png"))
        (folder / name).unlink()

    return spoil


def renamed(name: str, new: str) -> Callable[[Path], object]:
    return lambda folder: (folder / name).rename(folder / new)


SPOTTED, TOO_ROUGH = np.array([1, 0.2, 1, 1]), np.array([255, 255, 255, 1])
MISTAKES: dict[str, tuple[Callable[[Path], object], dict[str, str], str]] = {
    "missing view": (gone("albedo/0001.exr"), {}, "albedo: expected a picture (.exr, .png) of each of 4 views, found no 0001"),
    "another size": (
        exr("albedo/0002.exr", 4, lambda image: image[:16]),
        {},
        "2.exr: expected 32 x 32 pixels like its view, found",
    ),
    "negative": (
        exr("albedo/0000.exr", 4, lambda image: image * [-1, -1, -1, 1]),
        {},
        "expected radiance, found the negative value",
    ),
    "alpha of bytes": (
        exr("albedo/0000.exr", 4, lambda image: image * [1, 1, 1, 255]),
        {},
        "0000.exr: expected alpha from 0 to 1, found",
    ),
    "both suffixes": (
        lambda folder: shutil.copy(folder / "albedo/0001.exr", folder / "albedo/0001.png"),
        {},
        "albedo: expected one picture, .exr or .png, of a name, found 2 called 0001",
    ),
    "no encoding": (as_png("albedo/0000.exr", "RGB"), {}, "0000.png: expected method.options.encoding=srgb or linear"),
    "grey albedo": (as_png("albedo/0000.exr", "L"), {"encoding": "srgb"}, "expected red, green and blue, found a picture in grey"),
    "one channel": (exr("albedo/0000.exr", 4, lambda image: image[..., :1]), {}, "expected channels R, G, B, found Y"),
    "colours": (exr("roughness/0000.exr", 4, lambda image: image * SPOTTED), {}, "expected one value of roughness a pixel"),
    "too rough": (exr("roughness/0000.exr", 4, lambda image: image * TOO_ROUGH), {}, "expected roughness from 0 to 1, found"),
    "10 before 9": (
        lambda folder: [renamed("albedo/0000.exr", "albedo/9.exr")(folder), renamed("albedo/0001.exr", "albedo/10.exr")(folder)],
        {"order": "sorted"},
        "expected the same order by name as by number, as of 08, 09, 10, found 0002, 0003, 9, 10",
    ),
    "nothing": (lambda folder: [*map(shutil.rmtree, folder.iterdir())], {}, "expected some of the folders albedo, roughness"),
    "other folder": (renamed("albedo", "albedo_gone"), {}, "unknown folder 'albedo_gone'; did you mean 'albedo'?"),
    "missing light": (renamed("relighting/night", "../night"), {}, "expected every novel light, found no relighting/night"),
    "other encoding": (lambda folder: None, {"encoding": "gamma"}, "unknown value of method.options.encoding: 'gamma'"),
    "two of one name": (lambda folder: None, {"twice": "yes"}, "expected views of different names, found 2 called 0000"),
    "no order": (lambda folder: None, {"order": "no.json"}, "no.json: no such file"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistake_is_one_sentence_that_names_it(scene: Scene, pictures: Path, case: str) -> None:
    spoil, given, said = MISTAKES[case]
    options = dict(given)
    spoil(pictures)
    if options.pop("twice", None):
        scene = replace(scene, test=(*scene.test, replace(scene.test[1], name=scene.test[0].name)))
    with pytest.raises(InputError, match=re.escape(said)) as error:
        brought(scene, BroughtImages, path=str(pictures), **options)
    assert "\n" not in str(error.value)


def test_two_views_of_one_camera_are_refused(scene: Scene, pictures: Path) -> None:
    """As brackets of exposures are: pictures are told apart by their cameras."""
    first, second, *others = scene.test
    twice = replace(scene, test=(first, replace(second, camera=first.camera), *others))
    with pytest.raises(InputError, match="albedo: expected views of different cameras, by which pictures are told apart"):
        brought(twice, BroughtImages, path=str(pictures))
