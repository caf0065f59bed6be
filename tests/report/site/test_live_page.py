"""A page that is watched: a real watch over run folders that change, looked at in a browser; ended with Ctrl-C."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from ia_bench.runs.folder import lock_folder

CELLS = [("none", 0), ("none", 1), ("kernel", 0), ("kernel", 1)]
CURVE = "fit,1,1.5,10,11,12,13,0.2\nfit,2,3,11,12,13,14,0.1\n"


@pytest.fixture
def results(tmp_path: Path, write_run_below: Callable[..., Path]) -> Path:
    """A table of two rows and two seeds on hat, of which one cell has finished and one has failed."""
    write = partial(write_run_below, tmp_path)
    common = {"scene": "hat", "config_hash": "0" * 8}
    listed = [
        {"row": row, "seed": seed, "folder": f"runs/{row}-hat-{seed}", "log": f"logs/{row}-{seed}"} | common for row, seed in CELLS
    ]
    (tmp_path / "cells.json").write_text(json.dumps({"table": "mine", "jobs": 1, "cells": listed}))
    write("none", "hat", 0, psnr=20.0, curve=CURVE)
    write("none", "hat", 1, status="failed", error="boom", metrics={})
    return tmp_path


@pytest.fixture
def watched(results: Path) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "ia_bench", "watch", str(results), "--every", "0.2"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline().startswith(f"{results}/live/index.html opens in a browser")
    yield process
    process.kill()
    process.communicate()


def news(results: Path) -> dict[str, Any]:
    text = (results / "live" / "parts" / "live.js").read_text()
    return json.loads(text.removeprefix("bench.news(").removesuffix(");\n"))


def told(results: Path, wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    deadline = time.monotonic() + 1200
    while not ((results / "live" / "parts" / "live.js").is_file() and wanted(news(results))):
        assert time.monotonic() < deadline, news(results)
        time.sleep(0.05)
    return news(results)


def test_a_watch_follows_until_ctrl_c(results: Path, watched: subprocess.Popen[str], write_run_below: Callable[..., Path]) -> None:
    first = told(results, lambda one: bool(one["cells"]))
    assert [cell[3] for cell in first["cells"]] == ["finished", "failed", "waiting", "waiting"]
    assert first["left"] == 120  # two cells of a minute each, one after the other
    files = {path: path.stat().st_mtime_ns for path in (results / "runs").rglob("*")}
    folder = results / "runs" / "kernel-hat-0"
    with lock_folder(folder, print):
        (folder / "curve.csv").write_text((results / "runs" / "none-hat-0" / "curve.csv").read_text())
        growing = told(results, lambda one: one["cells"][2][3] == "running" and bool(one["curves"]))
    assert growing["curves"][0]["seconds"] == [1.5, 3.0]
    assert growing["key"] == first["key"]
    assert {path: path.stat().st_mtime_ns for path in files} == files
    write_run_below(results, "kernel", "hat", 1, psnr=22.0)
    assert told(results, lambda one: one["cells"][3][3] == "finished")["key"] != first["key"]
    watched.send_signal(signal.SIGINT)
    _, said = watched.communicate(timeout=1200)
    assert (watched.returncode, "Traceback" in said) == (0, False)
    assert news(results)["ended"]
    assert "22.00" in (results / "live" / "index.html").read_text()


def test_the_page_shows_the_cells_their_curves_and_what_has_finished_since(
    results: Path, watched: subprocess.Popen[str], write_run_below: Callable[..., Path], open_page: Callable[[Path], Any]
) -> None:
    told(results, lambda one: True)
    page = open_page(results / "live")
    page.wait_for_function("document.querySelector('#now-said').textContent.startsWith('4 cells: 1 finished, 2 waiting, 1 failed')")
    assert page.locator("#now-cells .mark").all_inner_texts() == ["✓", "✕", "○", "○"]
    page.locator("#now-cells .mark.failed").hover()
    assert "none, hat, seed 1: failed (boom)" in page.locator("#tip").inner_text()
    folder = results / "runs" / "kernel-hat-0"
    with lock_folder(folder, print):
        (folder / "curve.csv").write_text((results / "runs" / "none-hat-0" / "curve.csv").read_text().replace(",14,", ",19,"))
        page.wait_for_function("document.querySelector('#now-running').textContent.startsWith('kernel, hat, seed 0: running')")
        page.locator("#curves").scroll_into_view_if_needed()
        page.wait_for_function("bench.plots.plots.length === 5 && bench.plots.growing.length === 1")
        assert page.locator(".chip").all_inner_texts() == ["none", "kernel"]
        assert page.evaluate("bench.plots.plots[3].scales.y.max") > 19
    write_run_below(results, "kernel", "hat", 1, psnr=22.0)
    number = page.locator("#scope-0 tr[data-row='kernel'] td >> nth=9").get_by_text("22.00")
    number.wait_for(timeout=1_200_000)  # the page loads itself again
    watched.send_signal(signal.SIGINT)
    page.wait_for_function("document.querySelector('#now-title').textContent.endsWith('when the watch ended')", timeout=1_200_000)
