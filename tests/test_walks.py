"""What docs/architecture.md says must be written to add a loss, a metric or a reader: each is done here.

The files of a walk are those of its row in the table there, no more and no fewer, in a folder where nothing else is.
"""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from ia_bench.cli.check import main as check
from ia_bench.cli.run import main as run

ROOT = Path(__file__).resolve().parents[1]
SHORT = ["preset=smoke", "device=cpu", "threads=1", "out=result"]
PROJECT = """
[build-system]
requires = ["hatchling"]
build-backend = "hatchling.build"

[project]
name = "{name}"
version = "0.1"

[project.entry-points."ia_bench.{kind}s"]
{name} = "{name}:{attribute}"
"""

LOSS = """
from dataclasses import dataclass

from ia_bench.methods.contract import Coupling


@dataclass(eq=False)
class MyLoss(Coupling):
    weight: float = 1.0

    def uses(self, provides):
        return provides & {"albedo"}

    def prepare(self, samples, problem):
        self.wanted, self.counts = samples.values["albedo"], samples.weight

    def loss(self, render, pixels):
        return {"albedo": self.weight * (self.counts[pixels] * (render.albedo - self.wanted[pixels]).square()).mean()}
"""

READER = """
from dataclasses import replace
from pathlib import Path

from ia_bench.readers.native import NativeReader


class MyReader:
    def __init__(self, path: Path, *, stride: int = 2):
        self.native, self.stride = NativeReader(path), stride

    def read(self, truth):
        scene = self.native.read(truth)
        return replace(scene, train=scene.train[:: self.stride])
"""

METRIC = """

def absolute_error(pair: Compared) -> float:
    \"\"\"Mean of |predicted - true| over the area's pixels and channels.\"\"\"
    if not pair.area.any():
        raise NoScoredPixel
    return float(np.abs(pair.predicted[pair.area] - pair.true[pair.area]).mean())
"""
LINE = '    Metric("albedo", "mae", absolute_error, "Albedo", "MAE", higher_is_better=False, digits=4),\n'


def stated(what: str) -> set[str]:
    """The files that the table of docs/architecture.md names for adding ``what``."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    (row,) = re.findall(rf"^\| {what} \|([^|]*)\|", page, re.MULTILINE)
    return set(re.findall(r"`([^`]+)`", row))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder on the path, in which a stranger works."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "argv", ["ia_bench"])
    yield tmp_path
    for name in ("my_loss", "my_reader"):
        sys.modules.pop(name, None)


def write(folder: Path, files: dict[str, str]) -> None:
    for name, content in files.items():
        (folder / name).write_text(content, encoding="utf-8")


def install(folder: Path) -> None:
    """What an editable installation of the project in ``folder`` leaves of its pyproject.toml."""
    project = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    info = folder / f"{project['name']}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    groups = project["entry-points"].items()
    lines = (f"[{group}]\n" + "".join(f"{name} = {target}\n" for name, target in entries.items()) for group, entries in groups)
    (info / "entry_points.txt").write_text("".join(lines))


def metrics() -> dict[str, object]:
    found: dict[str, object] = json.loads(Path("result/metrics.json").read_text())
    assert found["status"] == "ok"
    return found


def test_a_loss(folder: Path, tiny_folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    files = {"my_loss.py": LOSS, "pyproject.toml": PROJECT.format(name="my_loss", kind="coupling", attribute="MyLoss")}
    assert stated("a loss") == files.keys()
    write(folder, files)
    install(folder)
    assert check(["coupling=my_loss", "coupling.options.weight=2"]) == 0
    assert run(["prior=oracle", "coupling=my_loss", "coupling.options.weight=2", f"scene.path={tiny_folder}", *SHORT]) == 0
    assert "coupling: my_loss, as it was set; it uses albedo" in capfd.readouterr().err
    metrics()


def test_a_reader(folder: Path, tiny_folder: Path) -> None:
    files = {"my_reader.py": READER, "pyproject.toml": PROJECT.format(name="my_reader", kind="reader", attribute="MyReader")}
    assert stated("a reader") == files.keys()
    write(folder, files)
    install(folder)
    assert check(["reader=my_reader", f"scene.path={tiny_folder}"]) == 0
    assert run(["reader=my_reader", "reader.options.stride=4", f"scene.path={tiny_folder}", *SHORT]) == 0
    metrics()


@pytest.mark.slow
def test_a_metric(tmp_path: Path, tiny_folder: Path) -> None:
    """One file of the package, here in a copy of it; what was measured before stays readable beside it."""
    for path in (ROOT / "ia_bench").rglob("*"):
        if path.is_file() and path.suffix != ".pyc":
            place = tmp_path / path.relative_to(ROOT)
            place.parent.mkdir(parents=True, exist_ok=True)
            place.symlink_to(path)
    changed = stated("a metric")
    assert changed == {"ia_bench/scores/metrics.py"}
    for name in changed:
        content = (ROOT / name).read_text(encoding="utf-8")
        content = content.replace("METRICS = (\n", f"{METRIC.strip()}\n\n\nMETRICS = (\n{LINE}")
        (tmp_path / name).unlink()
        (tmp_path / name).write_text(content, encoding="utf-8")
    published = str(ROOT / "docs" / "results" / "runs.csv")
    for arguments in ([f"scene.path={tiny_folder}", *SHORT], ["report", "result", published, "--out", "report"]):
        variables = {**os.environ, "PYTHONPATH": str(tmp_path), "OMP_NUM_THREADS": "1"}
        command = [sys.executable, "-m", "ia_bench", *arguments]
        ended = subprocess.run(command, cwd=tmp_path, env=variables, capture_output=True, text=True)
        assert ended.returncode == 0, ended.stderr
    found = json.loads((tmp_path / "result" / "metrics.json").read_text())["metrics"]["albedo"]["mae"]
    assert 0 < found < 1
    header, *_ = (tmp_path / "report" / "table.csv").read_text().splitlines()
    assert "albedo_mae" in header
