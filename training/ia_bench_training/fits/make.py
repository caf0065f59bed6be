"""One fit of a procedural scene as the refiner learns from it: a function of (seed, index) alone."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import SampledLight
from ia_bench.methods.contract import Monitor, Problem
from ia_bench.methods.photographs import count_views, view_geometry
from ia_bench.methods.regularisers.fusion import Fusion
from ia_bench.methods.regularisers.refiner import fitted_views
from ia_bench.methods.two_stage.method import TwoStage
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.render.reconstruction import TexturedReconstruction
from ia_bench_training.fit_files import FitInfo
from ia_bench_training.fits.scene import draw_scene

SHOWN = 6
"""A file shows at most so many of a scene's photographs."""
PIXELS = 640
"""A step of a fit takes so many pixels: photographs of 64 x 64 are then visited as often as some of 128 x 128 in a fit of
preset=quick, whose steps these are."""
TRIES = 4
"""So many scenes are drawn before an index is given up."""

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
    assert isinstance(recovered, TexturedReconstruction)
    assert isinstance(recovered.environment, LatLongEnvironment)
    material, light = recovered.material, SampledLight.of(recovered.environment.texels)
    generator, every = torch.Generator().manual_seed(index), tuple(range(len(views)))
    fitted = fitted_views(Fusion(problem, every), material, light, generator)
    normals, visibility = view_geometry(problem, shown)
    taken = [views[number] for number in shown]
    images = np.concatenate([np.stack([view.image for view in taken]), np.stack([view.mask for view in taken])[..., None]], -1)
    tensors = {
        "image": torch.from_numpy(images),
        **{name: images[list(shown)] for name, images in fitted.items()},
        "normal": normals,
        "visibility": visibility,
        "view_count": count_views(problem, shown),
        "true_albedo": torch.from_numpy(drawn.albedo[list(shown)]),
        "true_roughness": torch.from_numpy(drawn.roughness[list(shown)]),
    }
    halves = {name: values.detach().half() for name, values in tensors.items()}
    if not all(bool(torch.isfinite(values).all()) for values in halves.values()):
        raise FloatingPointError("a value beyond the range of half floats")
    return halves, FitInfo(seed, len(views))
