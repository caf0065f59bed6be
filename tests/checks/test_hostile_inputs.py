"""Some two thousand wrong inputs, drawn by seeds: each ends with the status of a mistake or of none, in one line and in time.

Files of every layout, of runs and of tables are changed in one place each, and so are command lines. What this finds is mended
where it enters, and becomes a case there (tests/readers/test_hostile.py and test_mistakes.py for what is wrong with scenes).
"""

import json
import os
import random
import shutil
import signal
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

import pytest
from readers.layouts import LAYOUTS, Layout, scene_to_write
from spoils import ODD_TEXTS, changed_somewhere

from ia_bench.cli.main import main
from ia_bench.common.exit_codes import MISTAKE, OK, status_of
from ia_bench.common.registry import find
from ia_bench.common.settings import flat
from ia_bench.runs.cells import look
from ia_bench.runs.composition import compose
from ia_bench.runs.config import ReaderConfig, SceneConfig
from ia_bench.runs.scene import read_scene
from ia_bench.scenes.scene import Scene

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("error::RuntimeWarning")]
SECONDS = 120  # for one input, on a machine with much else to do
WORDS = (
    *ODD_TEXTS, "pipe", "null", "3", "-1", "1.5", "-0", "1e400", "1e30", "true", "nan", "-inf", "０", "1_0", "[]", "{}", "[null]",
    "{a: 1}", "[", "'", '"', ":", "a=b", "${seed}", "${no}", "auto", "json:loads", "none,oracle", "--", "--out",
)  # fmt: skip
COMMANDS = (
    "score mesh.obj --light light.hdr --scene tiny", "relight mesh.obj --light light.hdr --out out.png", "verify runs.csv",
    "export tiny --format nerfstudio out", "decompose no.png --mask no.png", "check reader=dtu scene.path=runs",
    "table table=mine.yaml rows=a seeds=0", "report runs --out out --table paper", "rescore runs --out out",
    "pack runs --out out", "board runs --out out", "watch runs --every 1",
)  # fmt: skip


class Campaign:
    """Inputs that were tried, and how those ended that should not."""

    def __init__(self, seed: str, capfd: pytest.CaptureFixture[str]) -> None:
        self.draw, self.wrong, self._capfd = random.Random(seed), list[str](), capfd

    def tried(self, what: object, work: Callable[[], int]) -> None:
        signal.alarm(SECONDS)
        try:
            status: object = work()
        except SystemExit as end:  # of argparse
            status = end.code
        except BaseException as error:
            status = repr(error)
        finally:
            signal.alarm(0)
        said = self._capfd.readouterr().err
        if status not in (OK, MISTAKE) or "Traceback" in said:
            self.wrong.append(f"{what!r:.300}: {status}, {said[-600:]!r}")

    def spoiled(self, path: Path, work: Callable[[], int]) -> None:
        """Try a file with another value in one place, and put it back."""
        whole = path.read_bytes()
        wrong, what = changed_somewhere(self.draw, path.suffix, whole)
        path.write_bytes(wrong)
        self.tried((path.name, what), work)
        path.write_bytes(whole)


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    def too_long(*_: object) -> None:
        raise TimeoutError

    monkeypatch.chdir(tmp_path)
    before = signal.signal(signal.SIGALRM, too_long)
    yield
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.id)
def test_files_of_a_scene(layout: Layout, tiny: Scene, capfd: pytest.CaptureFixture[str]) -> None:
    campaign, folder = Campaign(layout.id, capfd), Path.cwd() / "tiny"
    reader = ReaderConfig(layout.name, find("reader", layout.name).target, dict(layout.write(folder, scene_to_write(tiny))))
    scene, files = SceneConfig(path=str(folder / layout.root)), sorted(path for path in folder.rglob("*") if path.is_file())
    for _ in range(100):
        suffix = campaign.draw.choice(sorted({path.suffix for path in files}))
        path = campaign.draw.choice([path for path in files if path.suffix == suffix])
        campaign.spoiled(path, lambda: status_of(lambda: (read_scene(scene, reader, truth=True), OK)[1]))
    assert not campaign.wrong


def test_files_of_runs_and_tables(ceiling: Path, capfd: pytest.CaptureFixture[str]) -> None:
    campaign, run, table = Campaign("runs", capfd), Path(shutil.copytree(ceiling, "runs/a")), Path("runs/cells.json")
    cell = {"row": "ceiling", "scene": "tiny", "seed": 3, "config_hash": "0", "folder": "a", "log": "log"}
    table.write_text(json.dumps({"table": "paper", "jobs": 1, "cells": [cell, cell | {"seed": 4, "folder": "b"}]}))
    for name in (*["metrics.json"] * 70, *["config.json"] * 30, *["curve.csv"] * 30):
        campaign.spoiled(run / name, lambda: main(["report", "runs/a", "--out", "out"]))
    for _ in range(30):
        campaign.spoiled(table, lambda: status_of(lambda: (look(Path("runs")), OK)[1]))
        campaign.spoiled(table, lambda: main(["report", "runs", "--out", "out"]))
    assert not campaign.wrong


def test_settings(capfd: pytest.CaptureFixture[str]) -> None:
    campaign, base = Campaign("settings", capfd), ["scene=tiny", "device=cpu", "preset=smoke"]
    keys = [key for key in (*flat(asdict(compose(base))), *asdict(compose(base)), "fit.pixels") if not key.startswith("command")]
    for _ in range(300):
        wrong = "".join(map(campaign.draw.choice, (("", "", "", "+", "~", "++"), keys, "=", WORDS)))
        campaign.tried(wrong, lambda wrong=wrong: main(["run", *base, wrong, "--cfg", "job"]))
    assert not campaign.wrong


def test_command_lines(capfd: pytest.CaptureFixture[str]) -> None:
    campaign = Campaign("commands", capfd)
    os.mkfifo("pipe")
    Path("runs").mkdir()
    Path("mine.yaml").write_text("scenes: [nowhere]\nrows: [{name: a, overrides: [prior=none]}]")
    Path("light.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n" + bytes(range(1, 33)))
    Path("mesh.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n")
    for _ in range(120):
        name, *given = campaign.draw.choice(COMMANDS).split()
        for place in campaign.draw.sample(range(len(given) + 1), campaign.draw.choice((1, 1, 2))):
            given[place : place + 1] = [campaign.draw.choice(WORDS)]
        campaign.tried((name, *given), lambda name=name, given=given: main([name, *given]))
    assert not campaign.wrong
