"""What the run folders of tests hold."""

from __future__ import annotations

HASH = "a" * 64
CONFIG = {"seed": 0, "fit": {"pixels": 4096, "rates": {"light": 0.1}}}
LABELS = {"row": "none", "scene": "hat", "seed": 0, "protocol": "paper-v1"}


def good_metrics() -> dict:
    return {
        "schema": 2,
        **LABELS,
        "config_hash": HASH,
        "status": "ok",
        "sees_truth": False,
        "metrics": {"albedo": {"psnr": 20.0}, "roughness": {"mse": None}},
        "reasons": {"roughness.mse": "no ground truth"},
        "per_image": {"albedo": {"psnr": [20.0]}},
        "time_s": {"total": 1.0},
        "peak_memory_bytes": 1,
        "rays": 1,
        "network_calls": 0,
        "plan": {"needed": [], "left_out": []},
        "environment": {},
        "files": {},
    }
