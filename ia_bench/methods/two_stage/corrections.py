"""What corrects a material between steps and after them, by the prior's settings: parsimony, a refiner, guesses of the unseen."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property

import torch
from torch import Tensor

from ia_bench.material.textures import Material
from ia_bench.methods.asking.sampling import PriorSampler
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.looks import looks, smoothed
from ia_bench.methods.two_stage.parameters import LEAST, Parameters
from ia_bench.methods.two_stage.parsimony import PLACES, passes, pooled
from ia_bench.methods.two_stage.refinement import Fusion, fitted_views, refined_albedo, refined_roughness
from ia_bench.methods.two_stage.symmetry import completed

ROUNDING = 1e-6
"""A value so little out of its range is one that was rounded."""


class Corrections:
    """The corrections of one fit, by ``problem.supervision``; each brings its textures back into their range.

    Attributes:
        clamped: How many values of texels that was needed for, by more than ROUNDING.
        seconds: What correcting took.
    """

    def __init__(self, problem: Problem, sampler: PriorSampler) -> None:
        self._problem, self._settings, self._sampler = problem, problem.supervision, sampler
        self.clamped, self.seconds = 0, 0.0

    def pool(self, step: int, steps: int, parameters: Parameters, generator: torch.Generator) -> None:
        """Where it is due after ``step`` of ``steps``: let the material be of few materials."""
        share = self._settings.parsimony
        if not share or step not in passes(steps) or "albedo" in parameters.frozen(step, steps):
            return
        with self._timed():
            material, fusion = parameters.material(detached=True), self._fusion.drawn(PLACES, generator)
            if not fusion:
                return
            albedo, roughness = fusion.looked_up(material.albedo), fusion.looked_up(material.roughness)
            mean_albedo, mean_roughness = pooled(albedo, roughness, fusion.position, generator)
            self._replace(parameters, "albedo", refined_albedo(fusion, material.albedo, albedo, mean_albedo, share))
            self._replace(parameters, "roughness", refined_roughness(fusion, material.roughness, roughness, mean_roughness, share))

    def refine(self, parameters: Parameters, generator: torch.Generator) -> None:
        """Let the prior correct what was recovered."""
        settings = self._settings
        if not settings.refinement and not settings.roughness_refinement:
            return
        with self._timed():
            material, fusion = parameters.material(detached=True), self._fusion
            exposures = None if parameters.exposures is None else parameters.exposures.recovered
            fitted = fitted_views(self._problem, fusion, self._sampler.views, material, parameters.light(), generator, exposures)
            renders = {name: images.cpu() for name, images in fitted.items()}
            corrected = self._sampler.refine(renders).values

            def both(name: str) -> tuple[Tensor, Tensor]:
                return fusion.pixels(renders[name]), fusion.pixels(corrected[name])

            self._replace(parameters, "albedo", refined_albedo(fusion, material.albedo, *both("albedo"), settings.refinement))
            if "roughness" in corrected:
                refined = refined_roughness(fusion, material.roughness, *both("roughness"), settings.roughness_refinement)
                self._replace(parameters, "roughness", refined)

    def complete(self, material: Material, observed: Tensor, generator: torch.Generator) -> Material:
        """The recovered ``material``, in which what photographs hardly show, or not at all, is guessed.

        ``observed`` (T, T) bool: texels that some photograph shows.
        """
        with self._timed():
            if self._settings.neighbours:
                material = smoothed(material, looks(self._problem, len(observed)), observed, self._settings.neighbours)
            if self._settings.symmetry:
                guessed = completed(self._problem.stage, material, observed, self._settings.symmetry, generator)
                albedo, roughness = (self._in_range(name, getattr(guessed, name)) for name in ("albedo", "roughness"))
                material = Material(albedo, roughness, guessed.metallic)
        return material

    @cached_property
    def _fusion(self) -> Fusion:
        """Of the views that the prior is asked about."""
        return Fusion(self._problem, self._sampler.views)

    def _replace(self, parameters: Parameters, name: str, texture: Tensor) -> None:
        parameters.tensors[name].copy_(self._in_range(name, texture))

    def _in_range(self, name: str, texture: Tensor) -> Tensor:
        """The ``texture`` as the fit allows it, and what that changed counted."""
        allowed = texture.clamp(LEAST[name], 1)
        self.clamped += int(((texture - allowed).abs() > ROUNDING).sum())
        return allowed

    @contextmanager
    def _timed(self) -> Iterator[None]:
        started = time.perf_counter()
        with torch.no_grad():
            yield
        self.seconds += time.perf_counter() - started
