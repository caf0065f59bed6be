"""The plain loop of Mitsuba 3 and Adam as a method: it keeps the contract, learns, and is told where Mitsuba is missing."""

import importlib.util
import sys

import pytest
import torch

from ia_bench.checks.methods import Memory
from ia_bench.common import registry
from ia_bench.common.errors import InputError
from ia_bench.methods.contract import Problem
from ia_bench.render.settings import RenderSettings
from ia_bench.scenes.scene import Scene
from ia_bench.scores.protocol import Protocol
from ia_bench.scores.scorer import Scorer
from ia_bench_baselines.mitsuba_adam.scene import import_mitsuba
from ia_bench_baselines.mitsuba_adam.settings import MitsubaAdamOptions

TARGET = "ia_bench_baselines.mitsuba_adam.method:MitsubaAdam"
RENDER = RenderSettings(samples=16, texture=64, light_height=16)


@pytest.fixture(scope="module")
def method() -> type:
    try:
        import_mitsuba(1)
    except InputError as error:
        pytest.skip(str(error))
    from ia_bench_baselines.mitsuba_adam.method import MitsubaAdam

    return MitsubaAdam


def test_where_mitsuba_is_missing_it_is_a_broken_plugin_of_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name == "mitsuba" else find(name, *rest))
    monkeypatch.delitem(sys.modules, TARGET.partition(":")[0], raising=False)
    with pytest.raises(InputError, match=r"method 'mitsuba_adam' .* cannot be used: .* pip install mitsuba") as caught:
        registry.load(registry.Plugin("method", "mitsuba_adam", TARGET, "ia_bench_baselines 0.1.0"))
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_it_explains_the_images_better_with_every_step(method: type, tiny: Scene) -> None:
    scorer, memory = Scorer(tiny, Protocol(), torch.device("cpu")), Memory()
    found = [
        scorer.quick(method(MitsubaAdamOptions(steps=steps)).fit(problem, seed=0, monitor=memory.monitor()).reconstruction)
        for steps in (1, 40)
        for problem in [Problem(tiny.blind(), RENDER)]
    ]
    assert found[1]["view_synthesis_psnr"] > found[0]["view_synthesis_psnr"] + 3
    assert found[1]["aligned_albedo_psnr"] > found[0]["aligned_albedo_psnr"]
