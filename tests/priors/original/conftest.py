"""A tiny release: the albedo and the specular model as Lightning checkpoints, and what the converter makes of them."""

from pathlib import Path

import pytest
from ldm import TINY, lightning, save, state_of, tiny

from ia_bench_training import convert_weights

SEEDS = {"albedo": 1, "specular": 2}


@pytest.fixture(scope="session")
def release(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`albedo/checkpoints/last.ckpt` and the same of specular, as the release lays them out."""
    folder = tmp_path_factory.mktemp("release")
    for component, seed in SEEDS.items():
        save(lightning(state_of(*tiny(seed))), folder / component / "checkpoints" / "last.ckpt")
    return folder


@pytest.fixture(scope="session")
def weights(release: Path) -> Path:
    """Both models converted; read only."""
    out = release / "converted"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(convert_weights, "RELEASE", TINY)
        for component in SEEDS:
            checkpoint = release / component / "checkpoints" / "last.ckpt"
            assert convert_weights.main([f"checkpoint={checkpoint}", f"out={out / component}"]) == 0
    return out
