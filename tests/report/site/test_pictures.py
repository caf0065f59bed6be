"""Pictures of the page: what is drawn against the truth, what is packed against other programs' reading of it."""

import base64
import gzip
import io
import json
import zipfile
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from ia_bench.common.errors import InputError
from ia_bench.common.paths import scenes_folders
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import direction_to_texel
from ia_bench.readers.native import NativeReader
from ia_bench.report.collect import Runs, as_table
from ia_bench.report.site import store
from ia_bench.report.site.page import Gallery, draw_pictures
from ia_bench.runs.pictures import packing
from ia_bench.runs.pictures.drawing import TURNS, Pictures, SceneRenderer
from ia_bench.runs.pictures.packing import bundle
from ia_bench.runs.pictures.preview import GAP, preview
from ia_bench.runs.recovered import Recovered
from ia_bench.scenes.scene import Scene, Truth


def runs_of(*runs: tuple[Path, str, int]) -> Runs:
    """Finished runs on tiny, by folder, row and seed."""
    return as_table({"folder": folder, "row": row, "scene": "tiny", "seed": seed} for folder, row, seed in runs)


def lay_out_pictures(runs: Runs, parts: Path, note: Callable[[str], None]) -> Gallery:
    store.lay_out_pictures(gallery := Gallery(), runs, parts, note)
    return gallery


def decoded(levels: np.ndarray) -> np.ndarray:
    """What the page makes of levels."""
    return packing.LARGEST * (levels / (packing.LEVELS - 1)) ** 2


def test_an_error_map_holds_the_root_mean_square_of_what_a_pixel_covers() -> None:
    """Blocks of 2 x 2 of a picture of 101 pixels; half of the first block has an error of .3, a quarter is not scored."""
    true = np.full((101, 101, 3), 0.4)
    predicted = true.copy()
    predicted[0, :2] += 0.3
    mask = np.ones((101, 101), bool)
    mask[1, 1] = False
    mask[50:, :50] = False
    levels = packing.error_map(predicted, true, mask)
    assert levels.shape == (51, 51)
    assert decoded(levels[0, 0]) == pytest.approx(0.3 * np.sqrt(2 / 3), rel=0.02)
    assert (levels[0, 1:] == 0).all()
    assert (levels[25:, :25] == packing.OUTSIDE).all()
    assert levels[50, 50] == 0
    assert decoded(packing.error_map(np.ones((4, 4, 1)), np.zeros((4, 4, 1)), np.ones((4, 4), bool)))[0, 0] == packing.LARGEST


def test_a_sheet_has_its_pictures_in_rows_of_five_and_a_texture_its_mean_and_side() -> None:
    pictures = [np.full((8, 8, 3), place / 10) for place in range(7)]
    image = np.asarray(Image.open(io.BytesIO(packing.sheet(pictures))).convert("RGB"))
    assert image.shape == (16, 40, 3)
    assert [image[8 * (place // 5), 8 * (place % 5), 0] for place in range(7)] == [round(25.5 * place) for place in range(7)]
    large = Image.open(io.BytesIO(packing.sheet([np.zeros((300, 300, 3))])))
    assert large.size == (packing.TILE, packing.TILE)
    # linear .25 is 137 of 255 on a display; roughness stays as it is
    large = packing.textures(np.full((512, 512, 3), 0.25), np.full((16, 16), 0.5))
    assert picture_of(large["albedo"]).shape == (256, 256, 3)
    assert picture_of(large["albedo"]).mean() == pytest.approx(137, abs=1.5)
    assert picture_of(large["roughness"]).mean() == pytest.approx(127.5, abs=1.5)


def test_a_light_is_read_back_from_radiance_where_a_viewer_looks_for_it() -> None:
    """The texel is m 2^(e - 136); a viewer finds direction (x, y, z), y up, at u = atan2(z, x) / 2 pi + 1/2, row 0 on top."""
    texels = torch.full((32, 64, 3), 0.01)
    ours = {(1.0, 0.0, 0.0): 3.0, (0.0, 1.0, 0.0): 5.0, (0.0, 0.0, 1.0): 0.7}  # +x, +y and up
    environment = LatLongEnvironment(texels)
    for direction, value in ours.items():
        texels.reshape(-1, 3)[direction_to_texel(torch.tensor([direction]), 32, 64)] = value
    header, _, body = base64.b64decode(packing.light(environment)).partition(b"-Y 32 +X 64\n")
    assert header.startswith(b"#?RADIANCE\n")
    bytes_ = np.frombuffer(body, np.uint8).reshape(32, 64, 4).astype(float)
    radiance = bytes_[..., :3] * 2.0 ** (bytes_[..., 3:] - 136)
    brightest = {round(float(radiance[..., 0][place]), 1): place for place in zip(*np.nonzero(radiance[..., 0] > 0.5), strict=True)}
    assert brightest[3.0][1] in (31, 32)  # +x: u = 1/2
    assert brightest[5.0][1] in (15, 16)  # our +y is the viewer's -z: u = 1/4
    assert brightest[0.7][0] == 0  # up
    assert 15 <= brightest[3.0][0] <= 16
    assert np.abs(np.median(radiance) - 0.01) < 0.01 / 128


def test_the_solid_is_the_mesh_to_less_than_a_pixel(tiny_folder: Path) -> None:
    mesh = NativeReader(tiny_folder).read(truth=False).expect_mesh()
    content = gzip.decompress(base64.b64decode(packing.solid(mesh)))
    found = next(iter(trimesh.load(io.BytesIO(content), file_type="glb", process=False).geometry.values()))
    assert found.faces.tolist() == mesh.faces.tolist()
    expected = mesh.vertices[:, [0, 2, 1]] * [1, 1, -1]  # y up
    assert np.abs(found.vertices - expected).max() <= 0.5 / 2**13 + 1e-6
    assert np.abs(found.visual.uv - mesh.uv).max() <= 0.5 / 2**12 + 1e-6


def picture_of(address: str) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(address.partition(",")[2]))).convert("RGB"), float)


@pytest.fixture(scope="module")
def drawn() -> tuple[SceneRenderer, Pictures]:
    scene_renderer = SceneRenderer(NativeReader(scenes_folders()[0] / "tiny").read(truth=True))
    return scene_renderer, scene_renderer.truth()


def test_a_perfect_run_looks_like_the_truth_once_it_is_aligned(drawn: tuple[SceneRenderer, Pictures], perfect_run: Path) -> None:
    """Its albedo is the truth over 1.25, so that errors before the alignment are those of that factor."""
    scene_renderer, truth = drawn
    run = Recovered(perfect_run)
    found = scene_renderer.recovered(run.reconstruction(scene_renderer.stage), run.scale)

    def error(name: str, original: str) -> float:
        squares = [(a - b) ** 2 for a, b in zip(found.values[name], truth.values[original], strict=True)]
        return float(
            np.sqrt(np.mean([part[mask].mean() for part, mask in zip(squares, scene_renderer.masks[original], strict=True)]))
        )

    assert error("aligned", "albedo") < 0.03  # four points a pixel of a fine pattern
    assert error("albedo", "albedo") > 0.04
    assert error("roughness", "roughness") < 0.03
    assert error("relit", "relit") < 0.05  # Monte Carlo noise at 64 samples a pixel
    assert np.abs(found.sheets["light"][0] - truth.sheets["light"][0]).mean() < 0.01


def test_a_run_without_light_is_pictured_without_what_needs_one(drawn: tuple[SceneRenderer, Pictures], perfect_run: Path) -> None:
    (perfect_run / "light.exr").unlink()
    scene_renderer, truth = drawn
    run = Recovered(perfect_run)
    found = run.reconstruction(scene_renderer.stage)
    packed = bundle(scene_renderer, truth, found, scene_renderer.recovered(found, run.scale))
    assert set(packed.sheets) == {"albedo", "aligned", "roughness", "relit", "turned"}
    assert set(packed.errors["sheets"]) == {"albedo", "aligned", "roughness", "relit"}


def lacking(scene: Scene, *parts: str) -> Scene:
    """The scene without some of its truth, or of its views."""
    maps = {name: None for name in ("albedo", "roughness") if name in parts}
    textures = {**vars(scene.truth), **maps}
    lights = {} if "lights" in parts else textures.pop("lights")
    textures.pop("lights", None)
    return replace(
        scene,
        truth=Truth(lights, **textures),
        mesh=None if "mesh" in parts else scene.mesh,
        test=() if "test" in parts else tuple(replace(view, **maps) for view in scene.test),
        novel=() if "novel" in parts else tuple(view for view in scene.novel if "lights" not in parts or view.light == "train"),
    )


@pytest.mark.parametrize(
    ("parts", "left_out"),
    [
        (["novel"], {"truth": {"relit", "turned"}, "found": {"relit", "turned"}}),
        (["albedo", "roughness", "lights"], {
            "truth": {"albedo", "roughness", "light", "relit", "turned"}, "found": {"aligned", "relit", "turned"},
        }),
    ],
)  # fmt: skip
def test_only_what_needs_truth_is_left_out(tiny: Scene, perfect_run: Path, parts: list[str], left_out: dict[str, set[str]]) -> None:
    """What is drawn without it is still right: the run is the perfect one, whose render is the photograph."""
    scene_renderer, run = SceneRenderer(lacking(tiny, *parts)), Recovered(perfect_run)
    found = run.reconstruction(scene_renderer.stage)
    truth, pictures = scene_renderer.truth(), scene_renderer.recovered(found, run.scale)
    assert set(truth.sheets) == {"photograph", "albedo", "roughness", "view", "relit", "turned", "light"} - left_out["truth"]
    assert set(pictures.sheets) == {"albedo", "aligned", "roughness", "view", "relit", "turned", "light"} - left_out["found"]
    for rendered, photograph, mask in zip(pictures.values["view"], truth.values["view"], scene_renderer.masks["view"], strict=True):
        assert np.abs(rendered - photograph)[mask].mean() < 0.05  # Monte Carlo noise at 64 samples a pixel
    assert len(pictures.sheets["albedo"]) == len(truth.sheets["photograph"]) == len(scene_renderer.test)
    packed = bundle(scene_renderer, truth, found, pictures)
    of_albedo = {"albedo", "aligned"} if "albedo" in truth.sheets else set()
    comparable = {"view", "relit"} | of_albedo | set(truth.sheets) & {"roughness"}
    assert set(packed.errors["sheets"]) == set(pictures.sheets) & comparable
    assert ("light" in packed.solid) == ("lights" in parts)


def test_training_photographs_stand_for_a_scene_that_holds_none_out(tiny: Scene, perfect_run: Path) -> None:
    """Their names are kept, and a page draws those, of however many photographs it reads."""
    scene_renderer, run = SceneRenderer(lacking(tiny, "albedo", "roughness", "lights", "test", "novel")), Recovered(perfect_run)
    found = run.reconstruction(scene_renderer.stage)
    packed = bundle(scene_renderer, scene_renderer.truth(), found, scene_renderer.recovered(found, run.scale))
    names = [view.name for view in tiny.train]
    assert packed.views.fitted == scene_renderer.fitted
    assert (scene_renderer.fitted[0], scene_renderer.fitted[-1], len(set(scene_renderer.fitted))) == (names[0], names[-1], 6)
    assert packed.shapes["view"] == packed.shapes["albedo"] == [6, 5]
    again = SceneRenderer(lacking(tiny, "test", "novel"), scene_renderer.fitted[1:3])
    assert [view.name for view in again.views] == scene_renderer.fitted[1:3]
    with pytest.raises(InputError, match="expected the training views that are pictured, found none named nobody"):
        SceneRenderer(tiny, ["nobody"])
    with pytest.raises(InputError, match="expected a view that can be shown, found none"):
        SceneRenderer(replace(tiny, train=(), test=(), novel=()))


def test_of_photographs_without_a_truth_all_is_shown_from_where_they_were_taken(tiny: Scene) -> None:
    photographs = tuple(replace(view, light="train", albedo=None, roughness=None) for view in tiny.train[::3])
    captured = replace(tiny, test=photographs[:2], novel=photographs, truth=None)
    shown = SceneRenderer(captured)
    assert [view.name for view in shown.test] == [view.name for view in shown.views]


@pytest.mark.parametrize("held_out", [1, 3, 10])
def test_the_preview_shows_render_and_maps_of_one_view(tiny: Scene, held_out: int) -> None:
    """Of a capture with true maps all held-out views have maps, every second a render, and every fourth another light."""
    seen = tuple(replace(view, light="train") for view in tiny.train[:held_out])
    relit = tuple(replace(view, light="sunset") for view in seen)
    shown = SceneRenderer(replace(tiny, test=seen, novel=(*seen, *relit)))
    views = {"view": shown.views, "relit": shown.relit["sunset"], "albedo": shown.test, "roughness": shown.test}
    number = {view.name: place for place, view in enumerate(seen)}
    painted = Pictures({name: [np.full((8, 8, 3), number[view.name] / 255) for view in of] for name, of in views.items()})
    picture = np.asarray(preview("", painted, painted, shown.of_one_view()))
    side = picture.shape[1] // len(views)
    middles = picture[-2 * GAP, side // 2 :: side, 0]
    assert middles.tolist() == [{1: 0, 3: 0, 10: 4}[held_out]] * len(views)
    assert shown.told_apart(shown.of_one_view()) == ""
    elsewhere = f"render of view {seen[0].name}, under a new light of view {shown.relit['sunset'][0].name}"
    if held_out > 1:
        told = shown.told_apart({"view": 0, "relit": 0, "albedo": 1})
        assert told == f"{elsewhere}, maps of view {shown.test[1].name}"


def test_the_turning_light_starts_as_it_is_and_goes_once_around(drawn: tuple[SceneRenderer, Pictures]) -> None:
    scene_renderer, truth = drawn
    views = next(iter(scene_renderer.relit.values()))
    relit = truth.sheets["relit"][len(views) // 2]  # the first light's middle one, as rendered by Cycles
    errors = [float(np.abs(picture - relit).mean()) for picture in truth.sheets["turned"]]
    assert len(errors) == TURNS
    assert int(np.argmin(errors)) == 0


def test_pictures_are_laid_out_the_truth_is_drawn_once_and_what_has_none_is_named(
    tmp_path: Path, perfect_run: Path, keep_pictures: Callable[..., None]
) -> None:
    record = json.loads((perfect_run / "metrics.json").read_text())
    record["per_image"] = {"albedo": {"psnr": [1.0, 2.0, None, 4.0]}, "roughness": {"mse": [0.1]}}
    (perfect_run / "metrics.json").write_text(json.dumps(record))
    bare = tmp_path / "bare"
    bare.mkdir()
    for name in ("metrics.json", "config.json"):
        (bare / name).write_text((perfect_run / name).read_text())
    keep_pictures(perfect_run)
    runs = runs_of((perfect_run, "perfect", 1), (bare, "no pictures", 0), (bare, "perfect", 2), (tmp_path, "failed", 0))
    runs.loc[3, "problem"] = "x"
    notes: list[str] = []
    gallery = lay_out_pictures(runs, tmp_path / "parts", notes.append)
    assert notes == ["pictures of tiny: the truth"]
    assert gallery.missing == ["no pictures, tiny: it has kept no pictures"]
    perfect = gallery.scenes["tiny"]["rows"]["perfect"]
    assert (perfect["sheets"]["albedo"], perfect.keys()) == ([4, 4], {"folder", "sheets", "scores"})
    scores = perfect["scores"]
    assert (scores["albedo"], scores["roughness"], len(scores["relit"])) == ([1.0, 2.0, None, 4.0], [None] * 4, 3)
    names = {path.name for path in (tmp_path / "parts").rglob("*") if path.is_file()}
    assert names >= {"albedo.webp", "aligned.webp", "turned.webp", "errors.js", "solid.js"}

    assert (lay_out_pictures(runs, tmp_path / "parts", notes.append), len(notes)) == (gallery, 1)
    next((tmp_path / "parts").glob("*/truth/drawn.json")).write_text('{"key": ')
    assert (lay_out_pictures(runs, tmp_path / "parts", notes.append), len(notes)) == (gallery, 2)
    lay_out_pictures(runs_of((perfect_run, "renamed", 1)), tmp_path / "parts", notes.append)
    (scene,) = (tmp_path / "parts").iterdir()
    assert {path.name.partition("-")[0] for path in scene.iterdir()} == {"truth", "renamed"}
    draw_pictures(runs.iloc[1:2], tmp_path / "parts", notes.append)
    assert list((tmp_path / "parts").iterdir()) == [], "a report without pictures keeps none of a former one"


def test_a_scene_that_changed_since_is_named(tmp_path: Path, perfect_run: Path, keep_pictures: Callable[..., None]) -> None:
    keep_pictures(perfect_run)
    record = json.loads((perfect_run / "config.json").read_text())
    record["identity"]["scene"]["content"] = "0" * 64
    (perfect_run / "config.json").write_text(json.dumps(record))
    gallery = lay_out_pictures(runs_of((perfect_run, "perfect", 0)), tmp_path / "parts", print)
    assert (gallery.scenes, gallery.relit) == ({}, False)
    assert "a file of the scene has changed since" in gallery.missing[0]


def test_rows_of_one_slug_have_pictures_of_their_own(tmp_path: Path, perfect_run: Path, keep_pictures: Callable[..., None]) -> None:
    keep_pictures(perfect_run)
    runs = runs_of(*((perfect_run, row, 0) for row in ("w/o prior", "w o prior", "Truth")))
    gallery = lay_out_pictures(runs, tmp_path / "parts", lambda line: None)
    assert [*gallery.scenes] == ["tiny"], gallery.missing
    folders = {row: about["folder"] for row, about in gallery.scenes["tiny"]["rows"].items()}
    assert folders.keys() == {"w/o prior", "w o prior", "Truth"}
    assert len({*map(str.casefold, folders.values()), "truth"}) == 4
    assert len([*(tmp_path / "parts").glob("*/*/errors.js")]) == 3


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"shapes": {"../../../evil.sh": [1, 1]}}, "shapes: expected words as names, found ../../../evil.sh"),
        ({"views": {}}, "views.test: expected a value, found None"),
        ({"solid": " " * (3 << 20)}, "3 MB of pictures, more than 2"),
    ],
)
def test_pictures_of_somebody_else_are_written_nowhere_else_and_spoil_no_report(
    changes: dict[str, object],
    says: str,
    tmp_path: Path,
    perfect_run: Path,
    keep_pictures: Callable[..., None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(packing, "ALL_BYTES", 2 << 20)
    keep_pictures(perfect_run)
    own = packing.read_bundle(perfect_run)
    assert own is not None
    assert own.zipped() == (perfect_run / packing.PICTURES).read_bytes()
    with zipfile.ZipFile(perfect_run / packing.PICTURES, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("about.json", json.dumps({"version": packing.VERSION, **asdict(replace(own, sheets={})), **changes}))
        archive.writestr("../../../evil.sh.webp", b"echo evil")
    gallery = lay_out_pictures(runs_of((perfect_run, "theirs", 0)), tmp_path / "parts", print)
    assert says in gallery.missing[0]
    assert not list(tmp_path.rglob("evil.sh"))
