"""The two methods that see the truth: the ceiling gives it back, the constant is what knows nothing but its mean."""

from dataclasses import replace

import numpy as np
import pytest
from small_fit import altered

from ia_bench.common.errors import InputError
from ia_bench.methods.contract import Monitor, Problem, Result
from ia_bench.methods.truth_seers import ROUGHNESS, Ceiling, Constant, NoOptions
from ia_bench.render.reconstruction import Quality
from ia_bench.scenes.scene import Scene


def found_by(method: type, problem: Problem) -> Result:
    return method(NoOptions()).fit(problem, seed=0, monitor=Monitor.silent())


def test_ceiling_returns_the_truth_and_builds_nothing_for_it(scene: Scene) -> None:
    problem = Problem(scene.blind(), truth=scene)
    found = found_by(Ceiling, problem)
    assert not {"plan", "gbuffer", "renderer", "prior"} & vars(problem).keys()
    assets = found.reconstruction.assets()
    np.testing.assert_array_equal(assets.albedo, scene.truth.albedo.astype(np.float32))
    np.testing.assert_array_equal(assets.light, scene.truth.lights["train"])
    assert (found.steps, dict(found.seconds), dict(found.counters)) == (0, {}, {})


def test_constant_is_one_grey_of_the_true_mean_under_a_light_that_explains_the_images(problem: Problem, scene: Scene) -> None:
    found = found_by(Constant, altered(problem, truth=scene))
    assets = found.reconstruction.assets()
    inside = [(view.albedo / view.mask.clip(1e-6)[..., None])[view.mask > 0.5] for view in scene.test]
    np.testing.assert_allclose(assets.albedo, np.concatenate(inside).mean(), rtol=1e-5)
    assert (assets.roughness == ROUGHNESS).all()
    assert (assets.light == assets.light[:1, :1]).all()
    rendered = found.reconstruction.render(
        [view.camera for view in scene.train], light=None, albedo_scale=None, quality=Quality(2, 64, 1)
    )
    mean = np.stack([view.image for view in scene.train]).mean((0, 1, 2))
    np.testing.assert_allclose(np.stack(rendered.images).mean((0, 1, 2)), mean, rtol=0.15)  # the problem has no bounces


@pytest.mark.parametrize("method", [Ceiling, Constant])
def test_without_truth_it_is_said_what_is_missing(method: type, problem: Problem, scene: Scene) -> None:
    nothing = replace(scene, truth=None, test=())
    with pytest.raises(InputError, match=f"^method={method.__name__.lower()}: scene tiny: expected .*, found"):
        found_by(method, altered(problem, truth=nothing))
