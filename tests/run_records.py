"""Folders of runs that were never made, with the record that a run writes."""

import json
from pathlib import Path

COMPONENTS = ("albedo", "aligned_albedo", "view_synthesis", "relighting")
HEADER = "stage,step,seconds,albedo_psnr,aligned_albedo_psnr,view_synthesis_psnr,relighting_psnr,roughness_mse"


def write_record(folder: Path, row: str, psnr: float | None = 20.0, scene: str = "hat", seed: int = 0, **changes: object) -> Path:
    """``changes`` replace top-level keys of metrics.json; ``curve`` is the text of curve.csv below its header."""
    folder.mkdir(parents=True, exist_ok=True)
    curve = changes.pop("curve", None)
    data = {
        "schema": 2,
        "row": row,
        "scene": scene,
        "seed": seed,
        "protocol": "paper-v1",
        "protocol_description": {"lpips": {"net": "alex"}},
        "config_hash": "0" * 8,
        "status": "ok",
        "sees_truth": False,
        "metrics": {name: {"psnr": psnr, "ssim": 0.9, "lpips": 0.1} for name in COMPONENTS} | {"roughness": {"mse": 0.05}},
        "reasons": {f"{name}.psnr": "undefined" for name in COMPONENTS} if psnr is None else {},
        "per_image": {},
        "time_s": {"total": 60.0, "bake": 5.0, "prior": 0.0, "stage1": 30.0, "stage2": 15.0, "score": 10.0},
        "peak_memory_bytes": 2**30,
        "rays": 1000,
        "network_calls": 0,
        "plan": {},
        "environment": {},
        "files": {},
    }
    (folder / "metrics.json").write_text(json.dumps(data | changes))
    if curve is not None:
        (folder / "curve.csv").write_text(f"{HEADER}\n{curve}")
    return folder
