"""The plain way to do it with Mitsuba 3: its renderer, its Adam, one random view a step.

What it shares with our fit: the scene, the sizes of textures and light, the tone map of the image loss, the L1 loss in
sRGB of a prior's albedo, the learning rates and their decay, the log radiance of the light, the start. What it has not:
samples in halves that judge each other (its image loss is an L1, whose sign comes from one set of samples and whose gradient
from another), batches of pixels from all views, stratified samples, smoothness, delays of single parameters, multigrid steps, a
step of light and albedo together, an albedo that is solved for at the end, metal, a target of the shading.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.seeds import derive_seed
from ia_bench.material.brdf import MIN_ROUGHNESS
from ia_bench.material.textures import Material
from ia_bench.methods.contract import Problem
from ia_bench.methods.couplings.sampler import pixel_samples
from ia_bench.methods.two_stage.fit import initial_albedo
from ia_bench.priors.contract import Samples
from ia_bench_baselines.mitsuba_adam.scene import MitsubaScene
from ia_bench_baselines.mitsuba_adam.settings import MitsubaAdamOptions

LIGHT = "log_light"  # the optimiser's name of what it finds of the light
START_RAYS = 16  # camera rays a pixel of the renders that set the initial light


class Loop:
    """Albedo, roughness and light of a scene without truth, fitted by Mitsuba step by step."""

    def __init__(self, problem: Problem, options: MitsubaAdamOptions, *, seed: int) -> None:
        """Textures and light are even and grey before :meth:`start`. Raises InputError where Mitsuba is missing."""
        self._problem, self._options, self._seed = problem, options, seed
        views, rows, size = problem.scene.train, problem.plan.light_height, problem.plan.texture
        self._order = np.random.default_rng(seed).integers(len(views), size=options.steps)
        self._scene = MitsubaScene(
            problem.scene.expect_mesh(),
            [view.camera for view in views],
            Material(torch.ones(size, size, 3), torch.ones(size, size, 1)),
            torch.ones(rows, 2 * rows, 3),
            depth=options.depth,
            threads=torch.get_num_threads(),
        )
        mi = self._scene.mi
        self._rays = max(1, round(problem.plan.samples / self._scene.samples_per_ray))
        self._images = [mi.TensorXf(np.ascontiguousarray(view.image, np.float32)) for view in views]
        known = [None if view.valid is None else view.valid[..., None].repeat(3, -1).astype(np.float32) for view in views]
        self._known = [None if valid is None else mi.TensorXf(valid) for valid in known]
        self._targets: dict[int, Tensor] = {}
        self._albedo: dict[int, Any] = {}  # the targets as Mitsuba has them
        names = self._scene.names
        rates = {"albedo": options.albedo_rate, "roughness": options.roughness_rate}
        self._rates = {names[key]: rate for key, rate in rates.items()} | {LIGHT: options.light_rate}
        self._optimizer = mi.ad.Adam(lr=options.albedo_rate, beta_1=0.9, beta_2=0.99)
        for key in rates:
            self._optimizer[names[key]] = self._scene.parameters[names[key]]
        self._optimizer[LIGHT] = mi.TensorXf(np.zeros(self._scene.parameters[names["light"]].shape, np.float32))
        self._show()

    def start(self, albedo: Mapping[int, Tensor] | None) -> None:
        """Begin with ``albedo``, what a prior says of some training views, premultiplied (H, W, 3), or None for no prior.

        The light is the even one under which the renders have the mean colour of the photographs.
        """
        mi, names, views = self._scene.mi, self._scene.names, self._problem.scene.train
        self._aim_at(albedo or {})
        material = initial_material(self._problem, self._options, albedo)
        for name, texture in (("albedo", material.albedo), ("roughness", material.roughness)):
            self._optimizer[names[name]] = type(self._optimizer[names[name]])(texture.numpy())
        self._show()
        seen = np.mean([view.image.mean((0, 1)) for view in views], axis=0)
        unlit = np.mean([self._scene.image(view, START_RAYS, 0).mean((0, 1)) for view in range(len(views))], axis=0)
        light = np.log(np.maximum(seen, 1e-8) / np.maximum(unlit, 1e-8))
        shape = self._scene.parameters[names["light"]].shape
        self._optimizer[LIGHT] = mi.TensorXf(np.broadcast_to(light, shape).astype(np.float32))
        self._show()

    def advance(self, step: int) -> float:
        """Take a step and return its loss: a random view, Adam, and the projection onto valid values."""
        dr, names, options = self._scene.dr, self._scene.names, self._options
        view = int(self._order[step])
        decay = options.final_rate ** (step / max(options.steps - 1, 1))
        self._optimizer.set_learning_rate({key: rate * decay for key, rate in self._rates.items()})
        rendered = self._scene.render(view, self._rays, seed=derive_seed(self._seed, step) % 2**32)
        error, known = self._tone_map(rendered) - self._tone_map(self._images[view]), self._known[view]
        above = dr.maximum(error, 0)  # which costs nothing where the photograph is a lower bound
        loss = dr.mean(dr.maximum(-error, 0) + (above if known is None else known * above))
        if view in self._albedo:
            difference = self._srgb(self._scene.albedo(view)) - self._srgb(self._albedo[view])
            loss += options.albedo_weight * dr.mean(dr.abs(difference))
        found = float(loss.array[0])
        if not math.isfinite(found):
            raise FloatingPointError(f"the loss of view {self._problem.scene.train[view].name} is {found}")
        dr.backward(loss)
        self._optimizer.step()
        for key, low in ((names["albedo"], 0.0), (names["roughness"], MIN_ROUGHNESS)):
            self._optimizer[key] = dr.clip(dr.detach(self._optimizer[key]), low, 1.0)
        self._show()
        dr.sync_thread()
        return found

    def recovered(self) -> tuple[Material, Tensor]:
        """Textures and light (H, W, 3) so far, in our conventions."""
        names, parameters = self._scene.names, self._scene.parameters
        albedo, roughness = (torch.from_numpy(np.array(parameters[names[key]])) for key in ("albedo", "roughness"))
        light = np.exp(np.array(self._optimizer[LIGHT]))[:, 1:-1, :3]
        return Material(albedo, roughness.reshape(*roughness.shape[:2], 1)), torch.from_numpy(light.copy())

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint holds: values and moments of Adam, and the prior's albedo."""
        kept = {}
        for key, (value, _, _, (count, first, second, _)) in self._optimizer.state.items():
            arrays = {"value": value, "first": first, "second": second}
            kept[key] = {name: torch.from_numpy(np.array(array)) for name, array in arrays.items()} | {"count": int(count[0])}
        return {"adam": kept, "targets": self._targets}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from :meth:`state_dict`."""
        self._aim_at(state["targets"])
        for key, kept in state["adam"].items():
            value, promoted, rate, (count, *moments, largest) = self._optimizer.state[key]
            first, second = (type(old)(kept[name].numpy()) for name, old in zip(("first", "second"), moments, strict=True))
            self._optimizer.state[key] = value, promoted, rate, (type(count)(kept["count"]), first, second, largest)
            self._optimizer[key] = type(value)(kept["value"].numpy())
        self._show()

    def _aim_at(self, albedo: Mapping[int, Tensor]) -> None:
        self._targets = dict(albedo)
        self._albedo = {view: self._scene.mi.TensorXf(np.ascontiguousarray(image)) for view, image in albedo.items()}

    def _show(self) -> None:
        """Give the optimiser's values to the scene."""
        names = self._scene.names
        for key in (names["albedo"], names["roughness"]):
            self._scene.parameters[key] = self._optimizer[key]
        self._scene.parameters[names["light"]] = self._scene.dr.exp(self._optimizer["log_light"])
        self._scene.parameters.update()

    def _srgb(self, linear: Any) -> Any:  # noqa: ANN401 (a Dr.Jit tensor)
        dr = self._scene.dr
        return dr.select(linear <= 0.0031308, 12.92 * linear, 1.055 * dr.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)

    def _tone_map(self, radiance: Any) -> Any:  # noqa: ANN401 (a Dr.Jit tensor)
        return self._srgb(self._scene.dr.log(1 + radiance))


def initial_material(problem: Problem, options: MitsubaAdamOptions, albedo: Mapping[int, Tensor] | None) -> Material:
    """Where our fit starts: the prior's albedo averaged in texture space, or a constant of the images' mean colour."""
    targets = None
    if albedo:
        targets = pixel_samples(problem, Samples({"albedo": torch.stack(list(albedo.values()))}), tuple(albedo))
    start, size = initial_albedo(problem, options.albedo_initial, targets), problem.plan.texture
    return Material(start.cpu().contiguous(), torch.full((size, size, 1), options.roughness_initial))
