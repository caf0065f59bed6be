"""Exposures that cameras recorded, in transforms.json or EXIF: training images are divided by them, renders are exposed by them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from layouts import scene_to_write
from PIL import ExifTags, Image
from spoils import edited

from ia_bench.capture.capture import captured, record
from ia_bench.capture.settings import CaptureSettings
from ia_bench.common.errors import InputError
from ia_bench.readers.nerfstudio import NerfstudioReader
from ia_bench.readers.pictures import recorded_exposure
from ia_bench.readers.writers.frames import write_nerfstudio
from ia_bench.scenes.images import Images
from ia_bench.scenes.scene import Scene, Truth
from ia_bench.scores.protocol import Protocol
from ia_bench.scores.scorer import Scorer

FACTORS = (0.5, 1.0, 0.8, 1.25)  # of photographs one after another
UNIT = 7.0  # in which cameras record them


def exposed(scene: Scene) -> Scene:
    """The scene's photographs under the training light, each multiplied by a known factor, which its camera records."""

    def one(place: int, split: str) -> Scene:
        view = getattr(scene, split)[place]
        factor = FACTORS[place % len(FACTORS)] if view.light == "train" else 1.0
        return replace(view, image=view.image * np.float32(factor), exposure=UNIT * factor)

    parts = {split: tuple(one(place, split) for place in range(len(getattr(scene, split)))) for split in ("train", "test", "novel")}
    return replace(scene, **parts)


def test_training_images_become_those_of_one_exposure(tiny: Scene) -> None:
    notes: list[str] = []
    taken = exposed(tiny)
    found = captured(taken, CaptureSettings(), notes.append)
    factors = [FACTORS[place % len(FACTORS)] for place in range(len(tiny.train))]
    unit = np.exp(np.mean(np.log(factors)))
    for after, before in zip(found.train, tiny.train, strict=True):
        np.testing.assert_allclose(after.image, unit * before.image, rtol=1e-5, atol=1e-7)
        assert after.exposure is None
    for after, given in zip(found.novel, taken.novel, strict=True):
        assert after.image is given.image  # a photograph is compared with as it was taken
    for place, after in enumerate(found.test):
        assert after.exposure == pytest.approx(FACTORS[place % len(FACTORS)] / unit)
    assert all(view.exposure is None for view in found.novel if view.light != "train")
    assert len([note for note in notes if "recorded exposures differ by up to 2.5 times" in note]) == 1
    assert not found.exposures_differ
    assert record(found, CaptureSettings())["recorded_exposures"] == "divided out"
    assert "recorded_exposures" not in record(captured(tiny, CaptureSettings(), notes.append), CaptureSettings())
    assert captured(exposed(tiny), CaptureSettings(exposure="per_image"), notes.append).exposures_differ


def test_exposures_that_are_alike_or_incomplete_change_nothing(tiny: Scene) -> None:
    parts = ("train", "test", "novel")
    alike = replace(tiny, **{part: tuple(replace(view, exposure=3.0) for view in getattr(tiny, part)) for part in parts})
    given, notes = exposed(tiny), list[str]()
    some = replace(given, train=(replace(given.train[0], exposure=None), *given.train[1:]))
    for scene in (alike, some):
        found = captured(scene, CaptureSettings(), notes.append)
        assert all(np.array_equal(a.image, b.image) for a, b in zip(found.train, scene.train, strict=True))
        assert all(view.exposure is None for view in (*found.train, *found.test, *found.novel))
    assert [note for note in notes if note.startswith("1 of ")] == notes


def test_a_render_is_exposed_as_the_photograph_that_it_is_compared_with(tiny: Scene) -> None:
    lit = tuple(view for view in tiny.novel if view.light == "train")
    truth = replace(tiny, test=(), novel=lit, truth=Truth({}))
    given = captured(exposed(truth), CaptureSettings(), lambda note: None)
    unit = 1 / np.exp(np.mean(np.log([FACTORS[place % len(FACTORS)] for place in range(len(tiny.train))])))

    class Perfect:
        renderer, environment = "made up", None

        def render(self, cameras: object, **_: object) -> Images:
            return Images(tuple(view.image / np.float32(unit) for view in lit), tuple(view.mask for view in lit))

        def assets(self) -> None:
            return None

    found = Scorer(given, Protocol(curve_stride=1), torch.device("cpu")).quick(Perfect())  # type: ignore[arg-type]
    assert found["view_synthesis_psnr"] > 100


def test_a_frame_s_exposure_replaces_what_exif_says(tmp_path: Path, tiny: Scene) -> None:
    write_nerfstudio(tmp_path, scene_to_write(tiny))
    edited("transforms.json", lambda c: [frame.update(exposure=1.0 + n) for n, frame in enumerate(c["frames"])])(tmp_path)
    scene = NerfstudioReader(tmp_path, shrink=2).read(truth=False)
    views = (*scene.train, *scene.test)
    assert [view.exposure for view in views] == [1.0 + n for n in range(len(views))]
    edited("transforms.json", lambda c: c["frames"][2].update(exposure=0))(tmp_path)
    with pytest.raises(InputError, match=r"frames\[2\]: exposure: expected a number above 0, found 0"):
        NerfstudioReader(tmp_path).read(truth=False)


def test_exposures_of_frames_and_of_exif_are_not_mixed(tmp_path: Path, tiny: Scene) -> None:
    """They may be in units of their own: a photograph without the one has none, so that none is believed."""
    write_nerfstudio(tmp_path, scene_to_write(tiny))
    record = Image.Exif()
    record[0x0112] = 1  # upright; of a record whose first part is empty Pillow writes nothing into a PNG
    record.get_ifd(0x8769).update({33434: 1 / 50, 34855: 400, 33437: 2.0})
    for path in (tmp_path / "images").iterdir():
        with Image.open(path) as picture:
            picture.save(path, exif=record)
    assert all(view.exposure == pytest.approx(2.0) for view in NerfstudioReader(tmp_path).read(truth=False).train)
    edited("transforms.json", lambda c: c["frames"][1].update(exposure=300.0))(tmp_path)
    scene = NerfstudioReader(tmp_path).read(truth=False)
    assert [view.exposure for view in scene.train] == [None, 300.0, *[None] * (len(scene.train) - 2)]
    notes = list[str]()
    captured(scene, CaptureSettings(geometry="hull", cells=16), notes.append)
    count = len(scene.train) + len(scene.test)
    assert notes[0] == f"{count - 1} of {count} photographs have no recorded exposure: all are taken for the same"


def test_exif(tmp_path: Path) -> None:
    picture = Image.new("RGB", (8, 8), "grey")
    picture.save(tmp_path / "bare.jpg")
    assert recorded_exposure(tmp_path / "bare.jpg") is None
    record = picture.getexif()
    record.get_ifd(0x8769).update({33434: 1 / 50, 34855: 400, 33437: 2.0})
    picture.save(tmp_path / "full.jpg", exif=record)
    assert recorded_exposure(tmp_path / "full.jpg") == pytest.approx(2.0)
    record.get_ifd(0x8769)[33437] = 0.0
    picture.save(tmp_path / "zero.jpg", exif=record)
    assert recorded_exposure(tmp_path / "zero.jpg") is None


@pytest.mark.parametrize("stop", [1e-200, 1e200])
def test_a_damaged_f_number_is_no_exposure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stop: float) -> None:
    Image.new("RGB", (2, 2)).save(tmp_path / "a.png")
    record = {ExifTags.Base.ExposureTime: 0.01, ExifTags.Base.ISOSpeedRatings: 100, ExifTags.Base.FNumber: stop}
    monkeypatch.setattr(Image.Exif, "get_ifd", lambda *_: record)
    assert recorded_exposure(tmp_path / "a.png") is None
