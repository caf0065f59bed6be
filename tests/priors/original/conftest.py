"""A tiny release: the albedo and the specular model as Lightning checkpoints, and what the converter makes of them."""

from __future__ import annotations

from pathlib import Path

import pytest
from ldm import LatentDiffusion, save

from ia_bench_training.convert_weights import main

SEEDS = {"albedo": 1, "specular": 2}


@pytest.fixture(scope="session")
def release(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`albedo/checkpoints/last.ckpt` and the same of specular, as the release lays them out."""
    folder = tmp_path_factory.mktemp("release")
    for component, seed in SEEDS.items():
        save(LatentDiffusion.tiny(seed).lightning(), folder / component / "checkpoints" / "last.ckpt")
    return folder


@pytest.fixture(scope="session")
def weights(release: Path) -> Path:
    """Both models converted; read only."""
    checkpoints = [f"{component}={release / component / 'checkpoints' / 'last.ckpt'}" for component in SEEDS]
    out = release / "converted"
    assert main([*checkpoints, f"out={out}", "resolution=32"]) == 0
    return out
