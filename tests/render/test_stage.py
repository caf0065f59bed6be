"""A stage builds what is asked for, once, and keeps it as long as there is room."""

from __future__ import annotations

import pytest
import torch
from shapes import camera_at, sphere

from ia_bench.render import stage as stage_module
from ia_bench.render.gbuffer import trace_gbuffer
from ia_bench.render.rays import make_rays
from ia_bench.render.stage import Stage

CPU = torch.device("cpu")
CAMERAS = [camera_at((2.0, 1.0, 1.5), pixels=8), camera_at((-2.0, 1.0, 1.5), pixels=8), camera_at((2.0, 0, 1), pixels=12)]


def test_a_gbuffer_is_traced_once_and_is_what_tracing_gives() -> None:
    stage = Stage(sphere(2), CPU)
    first = stage.gbuffer(CAMERAS[:2], 2)
    rays = stage.rays.rays
    assert stage.gbuffer(CAMERAS[:2], 2) is first
    assert stage.rays.rays == rays == 2 * 8 * 8 * 4
    assert stage.gbuffer(CAMERAS[:2], 3) is not first
    traced = trace_gbuffer(CAMERAS[:2], make_rays(stage.mesh, CPU), 2, CPU)
    assert torch.equal(traced.face, first.face)
    assert torch.equal(traced.barycentric, first.barycentric)


def test_views_of_any_size_come_in_batches_of_one_size(monkeypatch: pytest.MonkeyPatch) -> None:
    stage = Stage(sphere(2), CPU)
    assert [buffer.shape for buffer in stage.gbuffers(CAMERAS, 1)] == [(2, 8, 8), (1, 12, 12)]
    monkeypatch.setattr(stage_module, "BATCH_POINTS", 100)
    assert [buffer.shape for buffer in stage.gbuffers(CAMERAS, 1)] == [(1, 8, 8), (1, 8, 8), (1, 12, 12)]
