"""The regularisers of ``fit.regularise`` at work: when each is applied, and their textures brought back into their range."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from ia_bench.material.textures import Material
from ia_bench.methods.contract import FitState, Problem, Regulariser
from ia_bench.methods.regularisers.choice import regularisers_of
from ia_bench.methods.two_stage.parameters import LEAST, Parameters
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.priors.contract import Samples

ROUNDING = 1e-6
"""A value so little out of its range is one that was rounded."""


class Regularisation:
    """All regularisers of one fit, applied one after the other.

    Attributes:
        clamped: How many values of texels had to be brought back into their range, by more than ROUNDING.
    """

    def __init__(
        self, problem: Problem, settings: FitSettings, parameters: Parameters, refine: Callable[[dict[str, Tensor]], Samples]
    ) -> None:
        """``refine``: asks the prior to correct a fit's renders. Raises InputError for one that cannot be applied."""
        self._problem, self._parameters, self._refine = problem, parameters, refine
        self._regularisers = regularisers_of(settings.regularise, settings.regulariser_options)
        for regulariser in self._regularisers:
            regulariser.prepare(problem)
        self.clamped = 0

    @torch.no_grad()
    def between(self, step: int, steps: int, generator: torch.Generator) -> None:
        """Change the textures of the fit after ``step`` of ``steps`` where that is due, once the albedo is optimised at all."""
        due = [one for one in self._regularisers if not one.completes and one.due(step, steps)]
        if due and "albedo" not in self._parameters.frozen(step, steps):
            material = self._applied(due, self._parameters.material(detached=True), generator)
            for name in ("albedo", "roughness"):
                self._parameters.tensors[name].copy_(getattr(material, name))

    @torch.no_grad()
    def completed(self, material: Material, generator: torch.Generator) -> Material:
        """The finished ``material``, its unseen texels filled, in which what photographs hardly show is guessed."""
        return self._applied([one for one in self._regularisers if one.completes], material, generator)

    def state_dict(self) -> dict[str, int]:
        """For a checkpoint."""
        return {"clamped": self.clamped}

    def load_state_dict(self, state: Mapping[str, int]) -> None:
        """Take over a :meth:`state_dict`."""
        self.clamped = state["clamped"]

    def _applied(self, regularisers: list[Regulariser], material: Material, generator: torch.Generator) -> Material:
        parameters = self._parameters
        exposures = None if parameters.exposures is None else parameters.exposures.recovered
        state = FitState(self._problem, parameters.light(), exposures, parameters.observed, generator, self._refine)
        for regulariser in regularisers:
            moved = regulariser.apply(material, state)
            material = Material(self._in_range("albedo", moved), self._in_range("roughness", moved), moved.metallic)
        return material

    def _in_range(self, name: str, material: Material) -> Tensor:
        texture: Tensor = getattr(material, name)
        allowed = texture.clamp(LEAST[name], 1)
        self.clamped += int(((texture - allowed).abs() > ROUNDING).sum())
        return allowed
