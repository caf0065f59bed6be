"""The check of readers: a sound one passes, and everything that a reader can get wrong is one cross that says so."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from ia_bench.checks.finding import difference
from ia_bench.checks.readers import check_reader, write_sheet
from ia_bench.cli.check import main
from ia_bench.common.errors import InputError
from ia_bench.readers.contract import check_scene, unscored
from ia_bench.scenes.scene import Camera, Scene, Truth, View

LIT = np.ones((4, 8, 3), np.float32)


class Reading:
    """A reader of a scene that is there already, spoiled at every call by ``spoil``."""

    def __init__(self, scene: Scene, spoil: Callable[[Scene], object] = lambda scene: scene) -> None:
        self.scene, self.spoil = scene, spoil

    def read(self, truth: bool) -> object:
        return self.spoil(self.scene if truth else without_truth(self.scene))


def without_truth(scene: Scene) -> Scene:
    def views(split: tuple[View, ...]) -> tuple[View, ...]:
        return tuple(View(v.name, v.camera, v.image, v.mask, v.light) for v in split)

    return replace(scene, train=views(scene.train), test=views(scene.test), novel=views(scene.novel), truth=None)


def first(scene: Scene, split: str = "test", **changes: object) -> Scene:
    """The scene with other values in the first view of a split."""
    views = getattr(scene, split)
    return replace(scene, **{split: (replace(views[0], **changes), *views[1:])})


def camera(scene: Scene, **changes: object) -> Scene:
    return first(scene, camera=replace(scene.test[0].camera, **changes))


def lights(scene: Scene, **changed: np.ndarray) -> Scene:
    return replace(scene, truth=replace(scene.truth, lights={**scene.truth.lights, **changed}))


ODD3 = np.zeros((7, 20, 3), np.float32)
WRONG: dict[str, tuple[Callable[[Scene], object], str]] = {
    "nothing": (lambda s: None, "expected a Scene, found NoneType"),
    "name": (lambda s: replace(s, name=5), "name: expected one line of text, found 5"),
    "no views": (lambda s: replace(s, train=()), "expected at least one training view"),
    "view": (lambda s: replace(s, test=("0000",)), "test view 0000: expected a View with a Camera, found str"),
    "image type": (lambda s: first(s, image=s.test[0].image.astype(float)), r"image: expected \(32, 32, 3\) float32, found.*64"),
    "nan": (lambda s: first(s, image=s.test[0].image * np.float32(np.nan)), "image: expected finite values from 0 to 1e"),
    "negative": (lambda s: first(s, image=s.test[0].image - 1), "image: expected finite values from 0 to 1e.*, found -1"),
    "straight alpha": (lambda s: first(s, image=s.test[0].image + 1), "expected radiance premultiplied by the mask"),
    "mask of 255": (lambda s: first(s, mask=255 * s.test[0].mask), "mask: expected finite values from 0 to 1, found 0 to 255"),
    "no object": (lambda s: first(s, mask=0 * s.test[0].mask), "mask: expected a pixel above 0.5"),
    "roughness": (lambda s: first(s, roughness=s.test[0].roughness - 1), "roughness: expected.* from 0 to 1, found -1"),
    "focal": (lambda s: camera(s, focal=(0.0, 1.0)), "camera: focal: expected 2 numbers from 0.032 to 3.2e"),
    "centre": (lambda s: camera(s, centre=(np.nan, 1.0)), "camera: centre: expected 2 numbers"),
    "world": (lambda s: camera(s, to_world=2 * np.eye(4)), "camera: expected a rotation and a translation"),
    "camera": (lambda s: camera(s, width=31), r"image: expected \(32, 31, 3\)"),
    "a name that leads elsewhere": (lambda s: first(s, name="../../0000"), "test view ../../0000: expected a name by which files"),
    "an absolute name": (lambda s: first(s, name="/0000"), "expected a name by which files below a folder can be called"),
    "a light that leads elsewhere": (lambda s: lights(s, **{"../night": LIT}), r"light \.\./night: expected a name by which files"),
    "light of a test view": (lambda s: first(s, light="night"), "expected the training light"),
    "light": (lambda s: lights(s, night=np.zeros((4, 8, 3), np.float32)), "light night: expected radiance above 0"),
    "light below 0": (lambda s: lights(s, night=-np.ones((4, 8, 3), np.float32)), "light night: expected finite values from 0"),
    "faces": (lambda s: replace(s, mesh=replace(s.mesh, faces=s.mesh.faces + 1)), "faces: expected vertices 0 to"),
    "uv": (lambda s: replace(s, mesh=replace(s.mesh, uv=2 * s.mesh.uv)), "uv: expected finite values from 0 to 1"),
    "mesh": (lambda s: replace(s, mesh="cube"), "mesh: expected a Mesh, found str"),
    "generator": (lambda s: replace(s, train=(view for view in s.train)), "train: expected a tuple, found <generator"),
    "width of half pixels": (lambda s: camera(s, width=32.0), "camera: width: expected a whole number from 1 to .*, found 32.0"),
    "metallic": (lambda s: replace(s, metallic="yes"), "metallic: expected true or false, found 'yes'"),
    "saturation": (lambda s: replace(s, saturated_share=float("nan")), "saturated_share: expected a number from 0 to 1, found nan"),
    "oblong texture": (lambda s: replace(s, truth=replace(s.truth, albedo=ODD3)), "true albedo texture: expected"),
    "valid": (lambda s: first(s, valid=s.test[0].mask), r"valid: expected \(32, 32\) bool, found \(32, 32\) float32"),
}  # fmt: skip


def crosses(reader: object) -> list[str]:
    findings = list(check_reader(lambda: reader))  # type: ignore[arg-type,return-value]
    return [f"{finding.what}: {finding.found}" for finding in findings if finding.status == "fail"]


def test_a_sound_reader_passes_also_without_a_mesh(tiny: Scene) -> None:
    assert crosses(Reading(tiny)) == []
    assert unscored(tiny) == {}
    found = list(check_reader(lambda: Reading(replace(tiny, mesh=None))))  # type: ignore[arg-type,return-value]
    assert {finding.status for finding in found} == {"pass", "skip"}
    skipped = ["it has no mesh", "the object is 21 pixels wide, too few to tell a wrong focal length"]
    assert [finding.found for finding in found if finding.status == "skip"] == skipped
    with pytest.raises(InputError, match="expected a mesh, found none"):
        replace(tiny, mesh=None).expect_mesh()


@pytest.mark.parametrize(("spoil", "says"), WRONG.values(), ids=WRONG)
def test_a_scene_that_is_wrong_is_told(tiny: Scene, spoil: Callable[[Scene], object], says: str) -> None:
    with pytest.raises(InputError, match=says):
        check_scene(spoil(tiny), truth=True)
    found = list(check_reader(lambda: Reading(tiny, spoil)))  # type: ignore[arg-type,return-value]
    assert [finding.status for finding in found] == ["fail", "skip"]


def test_truth_that_nobody_asked_for(tiny: Scene) -> None:
    class Telling(Reading):
        def read(self, truth: bool) -> object:
            return self.scene

    (cross,) = crosses(Telling(tiny))
    assert "train view 0000: albedo: expected no truth, which was not asked for" in cross


def test_another_scene_at_every_call(tiny: Scene) -> None:
    calls: list[int] = []

    def brighter(scene: Scene) -> Scene:
        calls.append(1)
        return first(scene, "train", image=scene.train[0].image * np.float32(1 + len(calls)))

    found = crosses(Reading(tiny, brighter))
    assert [line.partition(":")[0] for line in found] == ["without truth", "reading again", "another reader"]
    assert "train[0].image" in found[0]


def test_a_reader_that_cannot_be_made_again_is_a_cross_and_no_traceback(tiny: Scene) -> None:
    made: list[int] = []

    def make() -> Reading:
        made.append(1)
        if len(made) == 3:
            raise OSError("its lock is held")
        return Reading(tiny, lambda scene: scene)

    found = [finding for finding in check_reader(make) if finding.status == "fail"]
    assert [finding.what for finding in found] == ["reading again"]
    assert found[0].found.startswith("OSError: its lock is held")


def test_held_out_views_and_cameras(tiny: Scene) -> None:
    trained = first(tiny, image=tiny.train[0].image, mask=tiny.train[0].mask)
    assert crosses(Reading(trained)) == ["held-out views: 0000"]
    turned = tuple(replace(v, camera=replace(v.camera, to_world=v.camera.to_world @ np.diag([1, -1, -1, 1]))) for v in tiny.train)
    cross, *others = crosses(Reading(replace(tiny, train=turned)))
    assert cross.startswith("mesh, cameras and masks")
    assert "OpenCV" in cross
    assert [other.partition(":")[0] for other in others] == ["masks"]  # such cameras leave no hull


def test_differences_are_found_wherever_they_are(tiny: Scene) -> None:
    assert difference(tiny, tiny) is None
    assert difference(tiny, replace(tiny, name="other")) == "scene.name"
    assert difference(tiny, replace(tiny, test=tiny.test[1:])) == "scene.test"
    assert difference(tiny, lights(tiny, other=np.ones(3))) == "scene.truth.lights['other']"
    assert difference(Camera(np.eye(4), (1, 1), (1, 1), 2, 2), Camera(np.ones((4, 4)), (1, 1), (1, 1), 2, 2)) == "scene.to_world"


def test_what_cannot_be_scored_has_its_reason(tiny: Scene) -> None:
    bare = check_scene(without_truth(tiny), truth=True)
    assert bare.truth == Truth(lights={})
    assert unscored(bare) == {
        "albedo": "4 of 4 test views have no true albedo",
        "roughness": "4 of 4 test views have no true roughness",
        "relighting": "no environment map of night, studio, sunset",
    }
    assert unscored(replace(bare, test=(), novel=())) == {
        "albedo": "no test views",
        "roughness": "no test views",
        "view_synthesis": "no novel views under the training light",
        "relighting": "no novel views under another light",
    }
    assert unscored(first(tiny, albedo=None)) == {
        "albedo": "1 of 4 test views have no true albedo",
        "relighting": "relit albedo is aligned to the truth first, and 1 of 4 test views have no true albedo",
    }


def test_command(tiny_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # where the picture of the scene is left
    assert main(["reader=native", f"scene.path={tiny_folder}"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].endswith(" passed, 0 failed, 0 skipped")
    assert (tmp_path / "runs" / "contact_sheets" / "tiny.png").is_file()
    assert not (tmp_path / "runs" / "tiny").exists()  # where runs of the scene lie, and nothing else
    (tmp_path / "empty").mkdir()
    assert main(["reader=native", f"scene.path={tmp_path / 'empty'}"]) == 1
    assert "scene.json: no such file" in capsys.readouterr().out


def test_what_was_found_and_a_picture_of_it(tiny: Scene, tmp_path: Path) -> None:
    saturated = np.zeros((32, 32), bool)
    saturated[:16] = True
    scene = first(lights(tiny), "train", valid=~saturated)
    sheet = tmp_path / "some" / "sheet.png"
    found = {finding.what: finding for finding in check_reader(lambda: Reading(scene), sheet)}  # type: ignore[arg-type,return-value]
    assert found["photographs"].found.startswith("16 of 32 x 32 pixels; the object fills 4")
    assert "0.0% of it is saturated" not in found["photographs"].found
    assert found["truth of test views"].found.startswith("albedo of 4, roughness of 4")
    assert found["lights"].found == "maps of night, studio, sunset, train"
    with Image.open(sheet) as picture:
        picture.load()
        assert picture.width > 8 * 150, "small photographs are enlarged, so that names above them do not overlap"
        colours = np.asarray(picture.convert("RGB")).reshape(-1, 3)
    assert (np.abs(colours - [255.0, 0, 0]).max(1) < 40).sum() > 100  # outlines
    bare = replace(without_truth(tiny), mesh=None, test=(), novel=())
    found = {finding.what: finding for finding in check_reader(lambda: Reading(bare), sheet)}  # type: ignore[arg-type,return-value]
    assert found["contact sheet"].status == "pass"
    assert found["lights"].found == "no map of train"
    assert found["truth of test views"].status == "skip"
    there = check_reader(lambda: Reading(tiny), tmp_path)  # type: ignore[arg-type,return-value]
    assert [finding.what for finding in there if finding.status == "fail"] == ["contact sheet"]


def test_the_sheet_shows_the_whole_capture(tiny: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 31 views the last one, or nearly so: a capture goes around the object."""
    shown: list[str] = []

    def labelled(rows: Any, width: int) -> Image.Image:
        shown.extend(name for row in rows for name, _ in row)
        return Image.new("RGB", (8, 8))

    monkeypatch.setattr("ia_bench.checks.readers.labelled", labelled)
    views = tuple(replace(tiny.train[number % len(tiny.train)], name=f"v{number:02}") for number in range(31))
    assert [one.status for one in write_sheet(replace(tiny, train=views), tmp_path / "sheet.png")] == ["pass"]
    assert shown[:16] == [f"v{31 * number // 16:02}" for number in range(16)]
