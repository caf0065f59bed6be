"""A stage keeps what it has traced, and looks at views of any size."""

import pytest
import torch
from shapes import camera_at, sphere

from ia_bench.render import stage as stage_module
from ia_bench.render.stage import Stage

CPU = torch.device("cpu")
CAMERAS = [camera_at((2.0, 1.0, 1.5), pixels=8), camera_at((-2.0, 1.0, 1.5), pixels=8), camera_at((2.0, 0, 1), pixels=12)]


def test_views_of_any_size_come_in_batches_of_one_size(monkeypatch: pytest.MonkeyPatch) -> None:
    stage = Stage(sphere(2), CPU)
    assert [buffer.shape for buffer in stage.gbuffers(CAMERAS, 1)] == [(2, 8, 8), (1, 12, 12)]
    assert stage.gbuffer(CAMERAS[:2], 1) is stage.gbuffer(CAMERAS[:2], 1)
    monkeypatch.setattr(stage_module, "BATCH_POINTS", 100)
    assert [buffer.shape for buffer in stage.gbuffers(CAMERAS, 1)] == [(1, 8, 8), (1, 8, 8), (1, 12, 12)]
