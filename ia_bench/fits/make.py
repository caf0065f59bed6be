"""One fit of a procedural scene as the refiner learns from it: a function of (seed, index) alone."""

from __future__ import annotations

from functools import cache

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.fits.scene import SIDE, draw_scene
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import SampledLight
from ia_bench.methods.asking.settings import SupervisionSettings
from ia_bench.methods.asking.views import evenly_spread
from ia_bench.methods.contract import Monitor, Problem
from ia_bench.methods.two_stage.evidence import photographed_evidence
from ia_bench.methods.two_stage.looks import looks
from ia_bench.methods.two_stage.method import TwoStage
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.methods.two_stage.surroundings import pictures
from ia_bench.priors.regressor import RegressorPrior
from ia_bench.render.reconstruction import TexturedReconstruction
from ia_bench.render.renderer import texture_images
from ia_bench.training.cameras import draw_camera
from ia_bench.training.fit_files import FitInfo

SUPERVISION = SupervisionSettings(
    kind="similarity", specular_weight=0, views="auto", parsimony=1, neighbours=0.2, symmetry=0.5, cache=False
)
"""That of prior=combined, whose fits the refiner is to correct, without a refiner."""
SHOWN = 8
"""Pictures of a fit in a file."""
CROPPED = 0.05
"""In this share of the pictures the object is larger than the frame."""
POINTS = 2
"""A pixel of the pictures has so many points along a side, as in a run."""
PIXELS = 640
"""A step of a fit takes so many pixels: photographs of 64 x 64 are then visited as often as some of 128 x 128 in a fit of
preset=quick, whose steps these are."""
TRIES = 4
"""So many scenes are drawn before an index is given up."""

_FIT = 7  # purpose of the random streams; those of training images are 1 and 2


def make_fit(seed: int, index: int, size: int) -> tuple[dict[str, Tensor], FitInfo]:
    """Fit ``index`` of ``seed`` in photographs of ``size`` pixels: tensors by the names of ``fit_files.CHANNELS``, float16.

    A scene that nothing can be fitted to (all black, say) is drawn again. Raises InputError where TRIES of them are.
    """
    for attempt in range(TRIES):
        rng = np.random.default_rng([seed, _FIT, index, attempt])
        try:
            return _fitted(rng, seed, index, size)
        except (InputError, FloatingPointError) as error:
            failure = error
    raise InputError(f"fit {index} of seed {seed}: expected a scene that can be fitted in {TRIES} draws, found none ({failure})")


@torch.no_grad()
def _fitted(rng: np.random.Generator, seed: int, index: int, size: int) -> tuple[dict[str, Tensor], FitInfo]:
    drawn = draw_scene(rng, size)
    problem = Problem(drawn.scene, supervision=SUPERVISION, make_prior=lambda _: _regressor(), note=lambda _: None)
    with torch.enable_grad():
        result = TwoStage(FitSettings(pixels=PIXELS)).fit(problem, seed=int(rng.integers(2**31)), monitor=Monitor.silent())
    recovered = result.reconstruction
    assert isinstance(recovered, TexturedReconstruction)
    assert isinstance(recovered.environment, LatLongEnvironment)
    material, light = recovered.material, SampledLight.of(recovered.environment.texels)
    asked = evenly_spread(problem.scene, problem.plan.prior_views)
    said = photographed_evidence(problem, asked, material, light, torch.Generator().manual_seed(index))
    cameras = [draw_camera(rng, problem.scene.expect_mesh().vertices, size, cropped=CROPPED) for _ in range(SHOWN)]
    gbuffer = problem.stage.gbuffer(cameras, POINTS)
    tensors = pictures(problem, gbuffer, cameras, material, said, looks(problem, len(material.albedo)))
    exact = problem.stage.gbuffer(cameras, SIDE)
    for name in ("albedo", "roughness"):
        tensors[f"true_{name}"] = texture_images(problem.stage.surface, exact, getattr(drawn.material, name))
    halves = {name: values.half() for name, values in tensors.items()}
    if not all(bool(torch.isfinite(values).all()) for values in halves.values()):
        raise FloatingPointError("a value beyond the range of half floats")
    return halves, FitInfo(seed, len(drawn.scene.train))


@cache
def _regressor() -> RegressorPrior:
    """The packaged one."""
    return RegressorPrior()
