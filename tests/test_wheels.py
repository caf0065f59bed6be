"""The three distributions as others get them: source archives, wheels made of these, an environment of their own, no checkout."""

import json
import os
import re
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest
from PIL import Image

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[1]
PARTS = {"ia_bench": ROOT, "ia_bench_baselines": ROOT / "baselines", "ia_bench_training": ROOT / "training"}
FOREIGN = ("PYTHONPATH", "IA_BENCH_DATASETS")
KEPT = {key: value for key, value in os.environ.items() if key not in FOREIGN} | {"OMP_NUM_THREADS": "1"}


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The wheel of each distribution, made of its source archive and not of the checkout."""
    folder = tmp_path_factory.mktemp("wheels")
    for part in PARTS.values():
        subprocess.run([sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", folder], cwd=part, check=True, env=KEPT)
    pip = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--no-index", "--quiet", "-w", folder]
    subprocess.run([*pip, *folder.glob("*.tar.gz")], check=True, env=KEPT)
    return {name: next(folder.glob(f"{name}-[0-9]*.whl")) for name in PARTS}


@pytest.fixture(scope="module")
def installed(wheels: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The commands of an environment that has the wheels; what they depend on is borrowed from this one, so nothing is loaded."""
    venv = tmp_path_factory.mktemp("environment") / "venv"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", venv], check=True)
    (site,) = (venv / "lib").glob("python*/site-packages")
    (site / "borrowed.pth").write_text("\n".join(path for path in sys.path if path.endswith("site-packages")))
    options = ["--no-deps", "--no-index", "--quiet"]
    pip = [sys.executable, "-m", "pip", "--python", venv / "bin" / "python", "install", *options]
    subprocess.run([*pip, *wheels.values()], check=True, env=KEPT)
    return venv / "bin"


@pytest.fixture
def call(installed: Path, tmp_path: Path):
    """Call one of those commands in an empty folder; what it printed, after its exit status was the expected one."""

    def called(name: str, *arguments: str, status: int = 0) -> str:
        done = subprocess.run([installed / name, *arguments], cwd=tmp_path, env=KEPT, capture_output=True, text=True)
        assert done.returncode == status, done.stdout + done.stderr
        return done.stderr if status else done.stdout

    return called


@pytest.mark.parametrize("name", PARTS)
def test_a_wheel_has_its_licence_a_card_of_all_weights_and_nothing_else(wheels: dict[str, Path], name: str) -> None:
    with zipfile.ZipFile(wheels[name]) as wheel:
        files = wheel.namelist()
        (metadata,) = (wheel.read(file).decode() for file in files if file.endswith(".dist-info/METADATA"))
    assert "License-Expression: Apache-2.0" in metadata
    assert [file for file in files if re.search(r"\.dist-info/licenses/LICENSE$", file)]
    cards = {Path(file).parent for file in files if Path(file).name.lower() in ("card.md", "readme.md")}
    weights = [Path(file) for file in files if file.endswith(".safetensors")]
    assert bool(weights) == (name != "ia_bench_training")
    assert not [file for file in weights if cards.isdisjoint(file.parents)]
    assert not [file for file in files if not re.match(rf"{name}(-[\d.]+dist-info)?/", file) or "__pycache__" in file]


def test_a_source_archive_has_one_scene_and_nothing_is_of_the_checkout(wheels: dict[str, Path], call, installed: Path) -> None:
    (archive,) = wheels["ia_bench"].parent.glob("ia_bench-[0-9]*.tar.gz")
    with tarfile.open(archive) as opened:
        scenes = {Path(name).parts[3] for name in opened.getnames() if "/datasets/scenes/" in name}
    assert scenes == {"tiny"}
    for name in PARTS:
        where = call("python", "-c", f"import {name}; print({name}.__path__[0])")
        assert where.startswith(str(installed.parent))


def test_the_scene_the_weights_and_the_settings_are_in_the_wheel(call, tmp_path: Path) -> None:
    assert "run " in call("ia-bench", "--help")
    assert "texture: 2048" in call("ia-bench", "run", "prior=oracle", "preset=paper", "--cfg", "job")
    call("ia-bench", "run", "scene=tiny", "preset=smoke", "device=cpu", "out=none")
    assert json.loads((tmp_path / "none" / "metrics.json").read_text())["status"] == "ok"
    Image.new("RGB", (64, 64), (200, 120, 40)).save(tmp_path / "photo.png")
    call("ia-bench", "decompose", "photo.png", "--samples", "1", "--out", "parts")
    assert (tmp_path / "parts" / "photo_albedo.exr").is_file()
    without = call("ia-bench", "run", "scene=hat", "device=cpu", status=2)
    assert "There are: tiny. " in without
    assert "IA_BENCH_DATASETS" in without
    assert "scene.path=FOLDER" in without


@pytest.mark.parametrize("chosen", ["method=nvdiffrec", "prior=yi"])
def test_a_baseline_is_found_by_its_name(call, tmp_path: Path, chosen: str) -> None:
    call("ia-bench", "run", chosen, "scene=tiny", "preset=smoke", "device=cpu", "out=result")
    assert json.loads((tmp_path / "result" / "metrics.json").read_text())["status"] == "ok"
    checked = call("ia-bench", "check", chosen).splitlines()
    assert " 0 failed, " in checked[-1]


@pytest.mark.parametrize("module", ["ia_bench_training.train", "ia_bench_training.prior_data", "ia_bench_baselines.yi.train"])
def test_training_says_what_it_takes(call, module: str) -> None:
    assert module in call("python", "-m", module, "--help")


def test_training_refuses_real_data_where_its_lists_are_missing(call, tmp_path: Path) -> None:
    (tmp_path / "real" / "objects" / "a").mkdir(parents=True)
    (tmp_path / "real" / "objects" / "a" / "b.glb").write_bytes(b"glTF")
    said = call("python", "-m", "ia_bench_training.world.make", "out=world", "real=real", status=2)
    assert said.count("\n") == 1
    assert "datasets/real" in said
