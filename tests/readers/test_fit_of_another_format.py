"""A fit of photographs that went through another format's 8 bits scores what the fit of the original photographs scores."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from nerf_writers import write_nerfstudio

from ia_bench.checks.methods import Memory
from ia_bench.methods.costs import CostTracker
from ia_bench.readers.contract import check_scene
from ia_bench.readers.nerfstudio import NerfstudioReader
from ia_bench.runs.composition import compose
from ia_bench.runs.config import method_of
from ia_bench.runs.run import problem_of
from ia_bench.scenes.scene import Scene
from ia_bench.scores.protocol import Protocol
from ia_bench.scores.scorer import Scorer


def view_synthesis(scene: Scene) -> float:
    """PSNR of held-out photographs after the shortest fit there is."""
    config = compose(["scene=tiny", "preset=smoke", "prior=none", "threads=1", "fit.stage1_steps=40", "fit.stage2_steps=0"])
    method, costs = method_of(config), CostTracker()
    problem = problem_of(config, scene, method.info, note=lambda line: None, costs=costs)

    found = method.fit(problem, seed=0, monitor=Memory().monitor()).reconstruction
    protocol = Protocol(samples_per_pixel=32, map_points=2, render_points=2)
    score = Scorer(scene, protocol, torch.device("cpu")).full(found).metrics["view_synthesis"]["psnr"]
    assert score is not None
    return score


@pytest.mark.slow
def test_eight_bits_cost_no_score(tmp_path: Path, tiny: Scene, tiny_folder: Path) -> None:
    """Half a step of 8 bits is 48 dB below white; the scores of these fits are near 20 dB, where that is less than .05 dB.

    Photographs are dimmed so that none is clipped: what clipping costs is another question.
    """
    dim = float(max((view.image.max(-1) / view.mask.clip(0.02)).max() for view in (*tiny.train, *tiny.test)))
    train, test = (tuple(replace(v, image=v.image / dim) for v in views) for views in (tiny.train, tiny.test))
    original = replace(tiny, train=train, test=test, novel=test)
    write_nerfstudio(tmp_path / "tiny", original)
    read = check_scene(NerfstudioReader(tmp_path / "tiny", mesh=str(tiny_folder / "mesh.ply")).read(truth=True), truth=True)
    assert view_synthesis(read) == pytest.approx(view_synthesis(original), abs=0.3)
