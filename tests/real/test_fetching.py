"""``make real-data`` from repositories: local ones in place of GitHub's, with content that is made here."""

import hashlib
import json
import subprocess
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from ia_bench.readers.nerfstudio import NerfstudioReader
from ia_bench.scenes.exr import read_rgbe


@pytest.fixture
def github(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of bare repositories that git takes for https://github.com."""
    folder = tmp_path / "github"
    settings = tmp_path / "gitconfig"
    settings.write_text(f'[url "file://{folder}/"]\n\tinsteadOf = https://github.com/\n[user]\n\tname = a\n\temail = a@b\n')
    monkeypatch.setenv("GIT_CONFIG_GLOBAL", str(settings))
    return folder


def publish(github: Path, name: str, work: Path) -> str:
    """Make the files in ``work`` a repository; its commit."""

    def git(*arguments: str) -> str:
        return subprocess.run(["git", "-C", str(work), *arguments], check=True, capture_output=True, text=True).stdout.strip()

    git("init", "--quiet")
    git("add", ".")
    git("commit", "--quiet", "-m", "all")
    bare = github / name
    subprocess.run(["git", "clone", "--quiet", "--bare", str(work), str(bare)], check=True)
    for key in ("uploadpack.allowFilter", "uploadpack.allowAnySHA1InWant"):
        subprocess.run(["git", "-C", str(bare), "config", key, "true"], check=True)
    return git("rev-parse", "HEAD")


def lists(folder: Path, sources: str, sums: dict[str, str]) -> Path:
    folder.mkdir()
    (folder / "sources.toml").write_text(sources)
    (folder / "sums.sha256").write_text("".join(f"{digest}  {path}\n" for path, digest in sums.items()))
    return folder


def source(repository: str, commit: str, recipe: str, rest: str) -> str:
    return f'[[source]]\nrepository = "{repository}"\ncommit = "{commit}"\n{recipe}\n{rest}\n'


@pytest.mark.parametrize("digits", [40, 10])
def test_a_light_is_the_nearest_rgbe_to_the_mean_of_four(
    digits: int, github: Path, fetch: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    radiance = np.exp(np.random.default_rng(0).normal(0, 3, (6, 24, 3)))
    radiance[:2, :12] = 0
    (tmp_path / "work" / "hdri").mkdir(parents=True)
    (tmp_path / "work" / "hdri" / "place_1k.hdr").write_bytes(fetch.rgbe(radiance, "made here"))
    commit = publish(github, "somebody/lights", tmp_path / "work")
    stored = read_rgbe(tmp_path / "work" / "hdri" / "place_1k.hdr").astype(np.float64)
    brightest = radiance.max(-1, keepdims=True)
    assert (np.abs(stored - radiance) <= brightest / 256).all()
    recipe, paths = 'recipe = "mean_of_2x2"', "[source.paths]\n"
    text = source("somebody/lights", commit[:digits], recipe, f'{paths}"lights/place.hdr" = "hdri/place_1k.hdr"')
    text += source("nobody/lights", "0" * 40, recipe, f'{paths}"lights/none.hdr" = "none.hdr"')
    text += source("nobody/objects", "0" * 40, "", 'files = ["objects/"]')
    wanted = dict.fromkeys(("lights/place.hdr", "lights/none.hdr", "objects/chair.glb"), "0" * 64)
    given = lists(tmp_path / "lists", text, wanted)
    assert fetch.main(["--lists", str(given), "--out", str(tmp_path / "out")]) == 1
    found = read_rgbe(tmp_path / "out/lights/place.hdr")
    mean = stored.reshape(3, 2, 12, 2, 3).mean((1, 3))
    assert (np.abs(found - mean) <= mean.max(-1, keepdims=True) / 256).all()
    shown, said = capsys.readouterr()
    assert "1 of 3 files, 0 of them as they are listed" in shown
    assert "1 files are only to be had by FROM=FOLDER, as how they were changed is no recipe: of nobody/objects" in shown
    assert said.count("\n") == 1
    assert said.startswith("nobody/lights at 0000000000: left out: git fetch")


def test_a_capture_in_llff_s_layout_becomes_one_that_is_read(github: Path, fetch: ModuleType, tmp_path: Path) -> None:
    work = tmp_path / "work"
    for name in ("images", "masks"):
        (work / name).mkdir(parents=True)
    poses, seconds = np.zeros((5, 17)), [0.01, 0.02, 0.01, 0.01, 0.04]
    for number in range(5):
        angle = 2 * np.pi * number / 5
        back = np.array([np.cos(angle), np.sin(angle), 0.0])
        down, position = np.array([0.0, 0.0, -1.0]), 4 * back
        right = np.cross(back, down)  # of OpenCV's axes right, down, forward
        poses[number, :15] = np.stack([down, right, back, position, [1000, 1280, 1500]], -1).ravel()
        picture = Image.fromarray(np.full((1000, 1280, 3), 40 * number + 20, np.uint8))
        record = picture.getexif()
        record.get_ifd(0x8769).update({33434: seconds[number], 34855: 100, 33437: 4.0})
        picture.save(work / "images" / f"IMG_{number}.JPG", quality=95, exif=record)
        mask = np.zeros((1000, 1280), np.uint8)
        mask[300:700, 400:801] = 255
        Image.fromarray(mask).save(work / "masks" / f"IMG_{number}_mask.JPG", quality=95)
    np.save(work / "poses_bounds.npy", poses)
    commit = publish(github, "somebody/thing", work)
    names = [name for n in range(5) for name in (f"images/IMG_{n}.jpg", f"masks/IMG_{n}.png")]
    wanted = dict.fromkeys((f"captures/thing/{name}" for name in (*names, "transforms.json", "poses_bounds.npy")), "0" * 64)
    given = lists(tmp_path / "lists", source("somebody/thing", commit, 'recipe = "llff"', 'files = ["captures/thing/"]'), wanted)
    assert fetch.main(["--lists", str(given), "--out", str(tmp_path / "out")]) == 0
    frames = json.loads((tmp_path / "out/captures/thing/transforms.json").read_text())["frames"]
    assert [frame["exposure"] for frame in frames] == pytest.approx([1, 2, 1, 1, 4])
    scene = NerfstudioReader(tmp_path / "out/captures/thing", every=3).read(truth=False)
    view = scene.train[0]
    assert view.name == "images/IMG_1"
    assert view.mask.shape == (500, 640)
    assert view.camera.focal == pytest.approx((750, 750))
    assert view.mask.sum() == pytest.approx(200 * 200.5, rel=0.01)
    assert view.image[250, 300] == pytest.approx(((60 / 255 + 0.055) / 1.055) ** 2.4, rel=0.03)
    assert view.camera.position == pytest.approx(4 * np.array([np.cos(2 * np.pi / 5), np.sin(2 * np.pi / 5), 0]))


def test_a_folder_with_another_file_changes_nothing(fetch: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "has" / "lights").mkdir(parents=True)
    (tmp_path / "has/lights/place.hdr").write_text("light")
    digest = hashlib.sha256(b"light").hexdigest()
    given = lists(tmp_path / "lists", source("a/b", "0" * 40, "", 'files = ["lights/"]'), {"lights/place.hdr": digest})
    assert fetch.main(["--lists", str(given), "--from", str(tmp_path / "has"), "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out/lights/place.hdr").read_text() == "light"
    (tmp_path / "has/lights/place.hdr").write_text("another")
    assert fetch.main(["--lists", str(given), "--from", str(tmp_path / "has"), "--out", str(tmp_path / "new")]) == 2
    assert "expected lights/place.hdr as it is listed, found another file (1 of 1 files)" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
    assert fetch.main(["--from", str(tmp_path / "nowhere"), "--out", str(tmp_path / "new")]) == 2
