"""The examples of third parties' plugins and the baselines, installed as they say."""

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from test_walks import stated

from ia_bench.checks.painted_ball import painted_ball, shown
from ia_bench.scenes.exr import read_exr

ROOT = Path(__file__).resolve().parent.parent
EXAMPLE = ROOT / "examples" / "grey_world_prior"
METHOD = ROOT / "examples" / "photograph_as_albedo"

pytestmark = pytest.mark.skipif(importlib.util.find_spec("hatchling") is None, reason="building it needs hatchling")


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Python of an environment with examples and baselines, installed as the pages say; the rest is borrowed from this one."""
    venv = tmp_path_factory.mktemp("installed") / "venv"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", venv], check=True)
    (site,) = (venv / "lib").glob("python*/site-packages")
    (site / "borrowed.pth").write_text("\n".join(path for path in sys.path if path.endswith("site-packages")))
    install(venv / "bin" / "python", EXAMPLE, METHOD, ROOT / "baselines")
    return venv / "bin" / "python"


def install(python: Path, *sources: Path) -> None:
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--quiet", "--disable-pip-version-check"]
    editable = [part for source in sources for part in ("-e", source)]
    subprocess.run([sys.executable, "-m", "pip", "--python", python, "install", *options, *editable], check=True)


def call(installed: Path, module: str, *arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    variables = {**os.environ, "PYTHONPATH": str(ROOT), "IA_BENCH_DATASETS": str(ROOT / "datasets"), "OMP_NUM_THREADS": "1"}
    command = [installed, "-m", module, *arguments]
    return subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True, timeout=1200)


def test_example_of_a_method_keeps_the_contract(installed: Path, tmp_path: Path) -> None:
    assert stated("a method") == {"my_method.py", "pyproject.toml"}
    done = call(installed, "ia_bench", "check", "method=photograph_as_albedo", folder=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "method photograph_as_albedo (photograph_as_albedo:PhotographAsAlbedo) on scene tiny" in done.stdout
    assert done.stdout.splitlines()[-1].endswith(" 0 failed, 1 skipped")  # it saves no checkpoint


@pytest.mark.slow
def test_a_baseline_is_copied_and_renamed_as_the_page_says(installed: Path, tmp_path: Path) -> None:
    """The commands and the pyproject.toml of docs/methods.md, in a folder where nothing else is."""
    page = (ROOT / "docs" / "methods.md").read_text().partition("## By copying a baseline")[2]
    (commands,), (project, *_) = (re.findall(f"```{kind}\n(.*?)```", page, re.DOTALL) for kind in ("sh", "toml"))
    (tmp_path / "baselines").symlink_to(ROOT / "baselines")
    subprocess.run(["sh", "-ec", commands], cwd=tmp_path, check=True)
    (tmp_path / "my_method" / "pyproject.toml").write_text(project)
    install(installed, tmp_path / "my_method")
    smoke = ["method.options.steps=4", "preset=smoke", "scene=tiny", "device=cpu", "threads=1", "out=result"]
    done = call(installed, "ia_bench", "method=my_method", *smoke, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    metrics = json.loads((tmp_path / "result" / "metrics.json").read_text())
    assert (metrics["row"], metrics["status"]) == ("my_method", "ok")


@pytest.mark.slow
def test_example_of_a_method_runs(installed: Path, tmp_path: Path) -> None:
    settings = ["method.options.mean=0.4", "preset=smoke", "scene=tiny", "device=cpu", "threads=1", "out=result"]
    done = call(installed, "ia_bench", "method=photograph_as_albedo", *settings, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    metrics = json.loads((tmp_path / "result" / "metrics.json").read_text())
    assert (metrics["row"], metrics["status"], metrics["sees_truth"]) == ("photograph_as_albedo", "ok", False)
    assert 0 < metrics["time_s"]["average"] < metrics["time_s"]["total"]
    assert read_exr(tmp_path / "result" / "albedo.exr", 3).mean() == pytest.approx(0.35, abs=0.05)  # texels beyond white are cut


def test_the_example_of_a_prior_is_found_by_its_entry_point_and_keeps_the_contract(installed: Path, tmp_path: Path) -> None:
    listed = call(installed, "ia_bench", "--choices", folder=tmp_path).stdout
    assert re.search(r"  mitsuba_adam +from ia_bench_baselines", listed)
    assert re.search(r"  grey_world +from grey_world_prior 0\.1\.0", listed)
    done = call(installed, "ia_bench", "check", "prior=grey_world", folder=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert " 0 failed, " in done.stdout.splitlines()[-1]
    assert done.stdout.count("✓") > 12
    assert "\x1b" not in done.stdout


def test_example_is_nearer_to_the_truth_than_the_image(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(EXAMPLE)
    from grey_world_prior import GreyWorldPrior

    stack = painted_ball(48, 64, 3)
    albedo = GreyWorldPrior().sample(shown(stack), seed=0).values["albedo"]
    inside = stack.masks > 0.5
    truth = stack.truth["albedo"][inside]

    def error(guess: np.ndarray) -> float:
        """Squared error after one common scale has made the means equal."""
        return float(((guess * (truth.mean() / guess.mean()) - truth) ** 2).mean())

    assert error(albedo[inside]) < 0.5 * error(stack.images[inside])
    monkeypatch.delitem(sys.modules, "grey_world_prior")
