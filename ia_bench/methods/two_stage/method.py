"""The paper's section 3.4: stage 1 with samples of the prior, stage 2 with samples guided by the current renders."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from ia_bench.common.registry import foreign_code
from ia_bench.methods.info import MethodInfo
from ia_bench.methods.two_stage.settings import PRESETS, FitSettings

if TYPE_CHECKING:
    from ia_bench.methods.contract import Monitor, Problem, Result


class TwoStage:
    """Adam on albedo, roughness, the log radiance of the light, and a colour that light and albedo share.

    Equation 5 of IntrinsicAnything (ECCV 2024, arXiv 2404.11593), section 3.4, but that the light is a map and not a network, and
    that halves of a pixel's samples judge each other where the paper has an L1.
    """

    Options: ClassVar[type] = FitSettings
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = PRESETS
    info = MethodInfo(fits_exposures=True, turns_light=True, uses_prior=True)

    def __init__(self, options: FitSettings) -> None:
        """``options``: what the paper leaves open."""
        self.options = options

    @property
    def fingerprint(self) -> str:
        """What decides numbers beside the options: the code of regularisers that are not the package's own."""
        found = {name: foreign_code("regulariser", name) for name in self.options.regularise}
        return " ".join(f"fit.regularise.{name}={code}" for name, code in found.items() if code is not None)

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        """See :class:`ia_bench.methods.contract.Method`. Resumes from the monitor's last checkpoint, to the same numbers.

        A step in which the loss, a gradient or a parameter is NaN or Inf is skipped, said and counted (``skipped_steps``).

        Raises:
            FloatingPointError: That happened PATIENCE times in a row; step and tensor are named, and the last good state
                is in the monitor's checkpoint.
            InputError: The prior cannot be used in the way that the problem's coupling or the settings say.
        """
        from ia_bench.methods.two_stage.fit import TwoStageFit  # brings in torch, as the next one does
        from ia_bench.methods.two_stage.metal import look_for_metal

        if problem.plan.metallic is None:
            look_for_metal(problem)
        with problem.costs.exclude("bake"):
            fit = TwoStageFit(problem, self.options, seed, monitor)
        return fit.finish()
