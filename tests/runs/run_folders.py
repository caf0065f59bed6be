"""What the run folders of tests hold."""

from dataclasses import asdict
from typing import Any

from ia_bench.runs.record import RunRecord

HASH = "a" * 64
CONFIG = {"seed": 0, "fit": {"pixels": 4096, "rates": {"light": 0.1}}}
LABELS: dict[str, Any] = {"row": "none", "scene": "hat", "seed": 0, "protocol": "paper-v1"}


def good_record() -> RunRecord:
    return RunRecord(
        **LABELS,
        config_hash=HASH,
        status="ok",
        metrics={"albedo": {"psnr": 20.0}, "roughness": {"mse": None}},
        reasons={"roughness.mse": "no ground truth"},
        per_image={"albedo": {"psnr": [20.0]}},
        time_s={"total": 1.0},
    )


def good_content() -> dict[str, Any]:
    return asdict(good_record())
