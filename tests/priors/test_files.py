"""``prior=files``: pictures of a folder as samples, by hand; every mistake in one sentence; and the way of a user."""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from spoils import Spoil, wrote

from ia_bench.cli.main import main
from ia_bench.common.declared import Declared
from ia_bench.common.errors import InputError
from ia_bench.priors.contract import Observations
from ia_bench.priors.files import FilesPrior, write_photographs
from ia_bench.priors.validation import ask
from ia_bench.runs.composition import compose
from ia_bench.runs.identity import hash_of, identity
from ia_bench.runs.record import RunRecord, row_seconds
from ia_bench.scenes.color import linear_to_srgb, srgb_to_linear
from ia_bench.scenes.exr import write_exr
from ia_bench.scenes.scene import Scene

HEIGHT, WIDTH = 12, 20
MASK = np.zeros((HEIGHT, WIDTH), np.float32)
MASK[2:10, 4:16] = 1
MASK[2, 4:16] = 0.5
TOLD = {"encoding": "srgb", "alpha": "straight"}


def shown(*names: str) -> Observations:
    masks = torch.from_numpy(np.stack([MASK] * len(names)))
    return Observations(0.3 * masks[..., None].expand(-1, -1, -1, 3), masks, tuple(range(len(names))), names=names)


def colours(height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    rows, columns = np.mgrid[:height, :width]
    return np.stack([rows / height, columns / width, 0.5 + 0 * rows], -1).astype(np.float32)


def save(path: Path, values: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".npy":
        np.save(path, values)
    elif path.suffix == ".exr":
        write_exr(path, values, half=False)
    else:
        Image.fromarray(np.round(255 * values).astype(np.uint8)).save(path)


def albedo(folder: Path, *names: str, seed: int = 0, **options: object) -> np.ndarray:
    prior = FilesPrior(path=str(folder), **{**TOLD, **options})
    return ask(prior, shown(*(names or ("a",))), seed=seed).values["albedo"].numpy()


# ---------------------------------------------------------------- what a picture means
@pytest.mark.parametrize("name", ["a.png", "a.exr", "a.npy"])
@pytest.mark.parametrize("encoding", ["srgb", "linear"])
@pytest.mark.parametrize("alpha", ["straight", "premultiplied", "none"])
def test_values_are_decoded_as_they_are_declared(tmp_path: Path, name: str, encoding: str, alpha: str) -> None:
    stored = colours()
    layers = [stored * MASK[..., None] if alpha == "premultiplied" else stored, *([MASK[..., None]] if alpha != "none" else [])]
    save(tmp_path / "albedo" / name, np.concatenate(layers, -1))
    found = albedo(tmp_path, encoding=encoding, alpha="straight" if alpha == "none" else alpha)[0]
    expected = (srgb_to_linear(stored) if encoding == "srgb" else stored) * MASK[..., None]
    step = 2.3 * 1.1 / 255 if name.endswith("png") else 1e-6
    assert np.abs(found - expected).max() <= step


def test_a_larger_picture_is_averaged_and_a_smaller_one_interpolated_without_the_background(tmp_path: Path) -> None:
    """Colours that are linear in place are kept by both, but at the picture's edges."""
    for scale in (2, 0.5):
        height, width = int(scale * HEIGHT), int(scale * WIDTH)
        rows, columns = (np.mgrid[:height, :width] + 0.5) / scale
        save(tmp_path / "albedo" / "a.npy", np.stack([rows / HEIGHT, columns / WIDTH, 0.5 + 0 * rows, 1 + 0 * rows], -1))
        found = albedo(tmp_path, encoding="linear")[0]
        rows, columns = np.mgrid[:HEIGHT, :WIDTH] + 0.5
        expected = np.stack([rows / HEIGHT, columns / WIDTH, 0.5 + 0 * rows], -1) * MASK[..., None]
        np.testing.assert_allclose(found, expected, atol=1e-5)
    # what alpha leaves out counts for nothing when a picture is made smaller, and the nearest colour stands where it is 0
    colour = np.where(MASK[..., None] > 0, 0.25, 1).repeat(3, -1)
    save(tmp_path / "albedo" / "a.npy", np.dstack([colour, MASK > 0.5]).repeat(2, 0).repeat(2, 1))
    np.testing.assert_allclose(albedo(tmp_path, encoding="linear")[0], 0.25 * MASK[..., None].repeat(3, -1), atol=1e-5)


def test_a_picture_shows_the_photograph_and_not_what_was_added_to_it(tmp_path: Path) -> None:
    """Photographs of other sizes stand at the upper left of one size for all."""
    small = (HEIGHT // 2, WIDTH - 5)
    values = colours(*small)
    save(tmp_path / "albedo" / "a.npy", values)
    seen = replace(shown("a"), sizes=(small,))
    seen.masks[:, small[0] :], seen.masks[:, :, small[1] :] = 0, 0
    found = FilesPrior(path=str(tmp_path), encoding="linear", alpha="straight").sample(seen, seed=0).values["albedo"][0].numpy()
    inside = MASK[: small[0], : small[1]] == 1
    np.testing.assert_allclose(found[: small[0], : small[1]][inside], values[inside], atol=1e-6)
    (tmp_path / "predictions.json").write_text(json.dumps({"views": {"a": {"size": [WIDTH, HEIGHT]}}}))
    with pytest.raises(InputError, match="expected the aspect of what it shows of view a, 20 x 12 pixels, found 15 x 6"):
        FilesPrior(path=str(tmp_path), encoding="linear", alpha="straight").sample(seen, seed=0)


def test_one_of_several_samples_is_drawn_by_the_seed(tmp_path: Path) -> None:
    for place, value in enumerate((0.2, 0.6)):
        for name in "abcdefgh":
            save(tmp_path / "albedo" / name / f"{place}.npy", np.full((HEIGHT, WIDTH, 3), value))
    assert FilesPrior(path=str(tmp_path), **TOLD).info.stochastic
    one, again, other = (albedo(tmp_path, *"abcdefgh", seed=seed, encoding="linear")[:, 5, 8, 0] for seed in (0, 0, 1))
    assert set(one.round(3)) == {np.float32(0.2), np.float32(0.6)}
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)
    assert albedo(tmp_path, "c", encoding="linear")[0, 5, 8, 0] == one[2]  # whatever stands beside it


def test_specular_is_in_the_units_of_the_photograph(tmp_path: Path) -> None:
    save(tmp_path / "specular" / "a.exr", np.full((HEIGHT, WIDTH, 3), 0.5, np.float32))
    (tmp_path / "predictions.json").write_text(json.dumps({"specular": TOLD, "views": {"a": {"exposure": 4}}}))
    samples = ask(FilesPrior(path=str(tmp_path)), shown("a"), seed=0)
    assert float(samples.values["specular"][0, 5, 8, 0]) == pytest.approx(float(srgb_to_linear(np.float32(0.5))) / 4)
    assert samples.ceilings["specular"].tolist() == [0.25]
    samples = ask(FilesPrior(path=str(tmp_path), encoding="linear"), shown("a"), seed=0)  # which has no end
    assert float(samples.values["specular"][0, 5, 8, 0]) == pytest.approx(0.125)
    assert not samples.ceilings


@pytest.mark.parametrize("crop", [False, True])
@pytest.mark.parametrize("size", [None, 32, 64])
def test_what_is_predicted_for_photographs_comes_to_its_place(tmp_path: Path, tiny: Scene, crop: bool, size: int | None) -> None:
    """A network that predicts a ramp across each photograph: it is found where the photograph showed it."""
    views = [replace(view, image=np.stack([view.mask * 0.5] * 3, -1)) for view in tiny.train[:2]]
    write_photographs(tmp_path, views, size=size, background="white", crop=crop)
    boxes = json.loads((tmp_path / "predictions.json").read_text())["views"]
    for view in views:
        with Image.open(tmp_path / "images" / f"{view.name}.png") as photo:
            assert photo.size == (size, size) if size else min(photo.size) >= (8 if crop else 32)
            ramp = (np.arange(photo.width) + 0.5) / photo.width
            save(tmp_path / "albedo" / f"{view.name}.npy", np.tile(ramp[None, :, None], (photo.height, 1, 3)))
    masks = torch.from_numpy(np.stack([view.mask for view in views]))
    asked = Observations(torch.zeros(2, 32, 32, 3), masks, (0, 1), names=tuple(view.name for view in views))
    found = ask(FilesPrior(path=str(tmp_path), encoding="linear", alpha="straight"), asked, seed=0).values["albedo"].numpy()
    for row, view in zip(found, views, strict=True):
        left, _, across, _ = boxes[view.name].get("box", [0, 0, 32, 32])
        place = np.broadcast_to((np.arange(32) + 0.5 - left) / across, (32, 32))
        inside = view.mask > 0.99
        assert np.abs(row[..., 0][inside] - place[inside]).max() < 1 / across  # at its rim the mask weighs a neighbour more


# ---------------------------------------------------------------- what it sees
def test_of_a_pattern_the_star_alone_has_a_meaning(tmp_path: Path) -> None:
    save(tmp_path / "net[2]?" / "a_albedo.png", colours())
    found = albedo(tmp_path, albedo="net[2]?/*_albedo.png")[0]
    assert np.abs(found - srgb_to_linear(colours()) * MASK[..., None]).max() <= 0.01


def test_a_suffix_in_upper_case_is_one_and_a_name_with_dots_is_whole(tmp_path: Path) -> None:
    save(tmp_path / "albedo" / "a.PNG", colours())
    save(tmp_path / "albedo" / "a.b.png", 1 - colours())
    (tmp_path / "albedo" / "a").mkdir()  # without a sample
    found = albedo(tmp_path, "a", "a.b")
    expected = srgb_to_linear(np.stack([colours(), 1 - colours()])) * MASK[..., None]
    assert np.abs(found - expected).max() <= 0.01


def test_names_of_views_may_have_folders(tmp_path: Path) -> None:
    """Where predictions.json says which views there are, a folder in their names is no folder of samples."""
    for name in ("cam0/0001", "cam1/0001"):
        save(tmp_path / "albedo" / f"{name}.png", colours())
    assert FilesPrior(path=str(tmp_path), **TOLD).info.stochastic
    (tmp_path / "predictions.json").write_text(json.dumps({"views": {"cam0/0001": {}, "cam1/0001": {}}}))
    assert not FilesPrior(path=str(tmp_path), **TOLD).info.stochastic


def test_it_sees_files_and_nothing_else(tmp_path: Path) -> None:
    save(tmp_path / "albedo" / "a.png", colours())
    prior, one = FilesPrior(path=str(tmp_path), **TOLD), shown("a")
    assert (prior.info.wants, prior.info.sees_truth, prior.info.guidable) == (frozenset(), False, False)
    other = replace(one, images=torch.rand_like(one.images))
    assert torch.equal(ask(prior, one, seed=0).values["albedo"], ask(prior, other, seed=5).values["albedo"])
    assert FilesPrior(path=str(tmp_path), **TOLD, sees_truth=True).info.sees_truth
    with pytest.raises(InputError, match="expected training views of a scene, by whose names"):
        prior.sample(replace(one, names=None), seed=0)


def test_a_run_is_known_by_the_predictions(tmp_path: Path) -> None:
    save(tmp_path / "albedo" / "0000.png", colours())
    (tmp_path / "images").mkdir()

    def known(folder: Path) -> str:
        options = [f"prior.options.{key}={value}" for key, value in {"path": folder, **TOLD}.items()]
        return hash_of(identity(compose(["scene=tiny", "prior=files", "preset=smoke", "device=cpu", *options])))

    first = known(tmp_path)
    save(tmp_path / "images" / "0000.png", colours())
    assert known(tmp_path) == known(Path(shutil.copytree(tmp_path, tmp_path.parent / "elsewhere"))) == first
    (tmp_path / "albedo" / "0000.png").rename(tmp_path / "albedo" / "0001.png")
    assert known(tmp_path) != first, "the name says which view it is of"
    save(tmp_path / "albedo" / "0000.png", 1 - colours())
    assert known(tmp_path) != first


# ---------------------------------------------------------------- mistakes
def picture(values: np.ndarray, name: str = "a.npy") -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        (folder / "albedo" / "a.png").unlink()
        save(folder / "albedo" / name, values)

    return spoil


def about(**said: object) -> Spoil:
    return wrote("predictions.json", said)


MISTAKES = {
    "nothing there": (lambda f: shutil.rmtree(f / "albedo"), {}, r"expected predictions as albedo/VIEW\.png .*, found none"),
    "other formats": (
        lambda f: [each.rename(each.with_suffix(".bmp")) for each in (f / "albedo").iterdir()],
        {},
        r"albedo/VIEW\.png \(or \.jpg, .*\.tif, \.npy\), or specular/, found none",
    ),
    "a view is missing": (lambda f: (f / "albedo/b.png").rename(f / "albedo/c.png"), {}, r"none of 1 of 2: b \(and a\.png among"),
    "encoding not said": (None, {"encoding": None}, r"predictions\.json: albedo\.encoding: expected linear or srgb, .* nothing"),
    "alpha not said": (None, {"alpha": None}, r"albedo\.alpha: expected straight or premultiplied, .* found nothing"),
    "unknown encoding": (about(albedo={"encoding": "gamma"}), {}, r"albedo\.encoding.* 'gamma'"),
    "unknown key": (about(albdo={}), {}, r"predictions\.json: .*albdo"),
    "a box of two": (about(views={"a": {"box": [1, 2]}}), {}, r"views\.a\.box"),
    "no exposure": (about(views={"a": {"exposure": 0}}), {}, r"views\.a\.exposure: expected 1e-06 or more"),
    "another capture": (about(views={"a": {"size": [64, 64]}}), {}, "view a with 64 x 64 pixels, found 20 x 12"),
    "a box beyond memory": (about(views={"a": {"box": [0, 0, 60000, 36000]}}), {}, r"a\.png: expected at most .*60000 x 36000"),
    "no JSON": (wrote("predictions.json", "{"), {}, "not valid JSON"),
    "another aspect": (picture(colours(12, 12)), {}, r"a\.npy: expected the aspect of .* view a, 20 x 12 pixels, found 12 x 12"),
    "not finite": (picture(np.nan * colours()), {}, r"a\.npy: expected finite numbers, found NaN"),
    "grey": (picture(colours()[..., 0], "a.png"), {}, r"a\.png: expected red, green and blue, found a picture in grey \(L\)"),
    "one channel": (picture(colours()[..., :1]), {}, r"a\.npy: expected \(height, width, 3\) values, .* \(12, 20, 1\)"),
    "0 to 255": (picture(200 * colours()), {}, r"a\.npy: expected albedo, which is srgb, in values from 0 to 1, found"),
    "-1 to 1": (picture(2 * colours() - 1), {}, r"in values from 0 to 1, found -0\.\d+ to"),
    "no object in alpha": (picture(np.dstack([colours(), MASK < 0.5])), {}, r"the object of view a, found \d+% of it covered"),
    "two formats": (lambda f: save(f / "albedo/a.exr", colours()), {}, r"expected one picture, .*, found a\.exr and a\.png"),
    "a picture and samples": (
        lambda f: save(f / "albedo/a/0.png", colours()),
        {},
        r"expected one picture, .* found a\.png and a/0\.png",
    ),
    "no star": (None, {"albedo": "albedo/a.png"}, r"expected where files lie below .*, found 'albedo/a\.png'"),
    "elsewhere": (None, {"albedo": "../*"}, r"expected where files lie below .*, found '\.\./\*'"),
    "no such pattern": (None, {"specular": "gloss/*"}, r"expected pictures of specular as gloss/\*, found none"),
    "no folder": (None, {"path": "nowhere"}, r"prior\.options\.path=nowhere: no such folder"),
    "no path": (None, {"path": None}, r"expected prior\.options\.path=FOLDER"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_sentence(tmp_path: Path, mistake: str) -> None:
    spoil, options, says = MISTAKES[mistake]
    for name in "ab":
        save(tmp_path / "albedo" / f"{name}.png", colours())
    if spoil is not None:
        spoil(tmp_path)
    with pytest.raises(InputError) as caught:
        FilesPrior(**{"path": str(tmp_path), **TOLD, **options}).sample(shown("a", "b"), seed=0)
    assert re.search(says, str(caught.value)), str(caught.value)
    assert "\n" not in str(caught.value)


# ---------------------------------------------------------------- as a user does it
def test_from_photographs_to_a_row_in_three_commands(
    tmp_path: Path, tiny: Scene, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["export", "tiny", "--for", "prior", "out", "--size", "64", "capture.views=8"]) == 0
    commands = (tmp_path / "out" / "README.txt").read_text()
    assert "ia-bench run scene=tiny capture.views=8 prior=files prior.options.path=out" in commands
    photos = sorted((tmp_path / "out" / "images").iterdir())
    assert len(photos) == 8
    for photo in photos:  # the network: every view's true albedo
        view = next(view for view in tiny.train if view.name == photo.stem)
        values = linear_to_srgb(view.albedo / np.maximum(view.mask, 1e-6)[..., None]).clip(0, 1).repeat(2, 0).repeat(2, 1)
        save(tmp_path / "out" / "albedo" / photo.name, values)
    short = ["scene=tiny", "capture.views=8", "preset=smoke", "device=cpu", "threads=1", "coupling=targets"]
    about = tmp_path / "out" / "predictions.json"
    about.write_text(json.dumps({**json.loads(about.read_text()), "declared": {"code": "a loop", "seconds": 100}}))
    told = ["prior.options.path=out", "prior.options.encoding=srgb", "prior.options.alpha=straight"]
    assert main(["run", *short, "prior=files", *told, "out=files"]) == 0
    assert main(["run", *short, "prior=none", "out=none"]) == 0
    records = [RunRecord.read(tmp_path / row) for row in ("files", "none")]
    files, none = (record.metrics for record in records)
    assert records[0].declared == Declared(code="a loop", seconds=100 + row_seconds(records[0].time_s))
    assert records[1].declared is None
    assert files["albedo"]["psnr"] > none["albedo"]["psnr"] + 5
    (tmp_path / "out" / "albedo" / photos[3].name).unlink()
    assert main(["run", *short, "prior=files", *told, "out=missing"]) == 2
    assert f"found none of 1 of 8: {photos[3].stem}" in capsys.readouterr().err
