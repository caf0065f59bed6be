"""The command line around a fake run, as tests call it."""

import json
import os
import sys
from pathlib import Path

from ia_bench.cli.run import main

HERE = Path(__file__).parent


def call(*arguments: str) -> int:
    return main(["device=cpu", "threads=1", *arguments])


def started() -> list[str]:
    """One line per start of the fake run."""
    log = Path(os.environ["FAKE_LOG"])
    return log.read_text().splitlines() if log.exists() else []


def results() -> list[dict]:
    return [json.loads(path.read_text()) for path in sorted(Path("runs").rglob("metrics.json"))]


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "ia_bench", "device=cpu", "threads=1", *arguments]
