"""One fit of a procedural scene as the refiner learns from it: a function of (seed, index) alone."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.fits.scene import draw_scene
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import SampledLight
from ia_bench.methods.asking.geometry import count_sightings, view_geometry
from ia_bench.methods.asking.views import restrict
from ia_bench.methods.contract import Monitor, Problem
from ia_bench.methods.two_stage.method import TwoStage
from ia_bench.methods.two_stage.refinement import Fusion, evidence
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.render.reconstruction import TexturedReconstruction
from ia_bench.render.renderer import texture_images
from ia_bench.training.fit_files import FitInfo

SHOWN = 6
"""Of a scene's photographs, at most, that a file shows."""
PIXELS = 640
"""Of a fit, in every step: photographs of 64 x 64 pixels are then visited as often as some of 128 x 128 in a fit of preset=quick,
whose steps these are."""
SAMPLES = 32
"""A pixel, for the specular shading."""
TRIES = 4
"""Scenes drawn before an index is given up."""

_FIT = 3  # purpose of the random streams; those of training images are 1 and 2


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


def _fitted(rng: np.random.Generator, seed: int, index: int, size: int) -> tuple[dict[str, Tensor], FitInfo]:
    drawn = draw_scene(rng, size)
    views = drawn.scene.train
    problem = Problem(drawn.scene, note=lambda _: None)
    result = TwoStage(FitSettings(pixels=PIXELS)).fit(problem, seed=int(rng.integers(2**31)), monitor=Monitor.silent())
    recovered = result.reconstruction
    shown = tuple(sorted(rng.choice(len(views), min(len(views), SHOWN), replace=False).tolist()))
    part, _ = restrict(problem.gbuffer, shown)
    assert isinstance(recovered, TexturedReconstruction)
    assert isinstance(recovered.environment, LatLongEnvironment)
    material, light = recovered.material, SampledLight.of(recovered.environment.texels)
    generator = torch.Generator().manual_seed(index)
    rendered = problem.renderer.render_images(problem.gbuffer, material, light, SAMPLES, generator)
    together = evidence(Fusion(problem, tuple(range(len(views)))), views, rendered, len(material.albedo))
    normals, visibility = view_geometry(problem, shown)
    taken = [views[number] for number in shown]
    images = np.concatenate([np.stack([view.image for view in taken]), np.stack([view.mask for view in taken])[..., None]], -1)
    tensors = {
        "image": torch.from_numpy(images),
        "albedo": texture_images(problem.renderer.surface, part, material.albedo),
        "roughness": texture_images(problem.renderer.surface, part, material.roughness),
        "radiance": rendered["radiance"][list(shown)],
        "specular": rendered["specular"][list(shown)],
        "evidence": texture_images(problem.renderer.surface, part, together),
        "normal": normals,
        "visibility": visibility,
        "sightings": count_sightings(problem, shown),
        "true_albedo": torch.from_numpy(drawn.albedo[list(shown)]),
        "true_roughness": torch.from_numpy(drawn.roughness[list(shown)]),
    }
    halves = {name: values.detach().half() for name, values in tensors.items()}
    if not all(bool(torch.isfinite(values).all()) for values in halves.values()):
        raise FloatingPointError("a value beyond the range of half floats")
    return halves, FitInfo(seed, index, len(views), int(drawn.clipped))
