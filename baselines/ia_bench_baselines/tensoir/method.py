"""TensoIR (Jin et al. 2023) on a shared mesh: one low-rank tensor for what is seen and for what it is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Field

from ia_bench.common.ranges import Count, Number, Rate, Weight
from ia_bench.methods.info import MethodInfo


@dataclass(frozen=True)
class TensoirOptions:
    """Sizes and weights; the size of the exported textures is the plan's, ``render.texture``.

    Attributes:
        head: Which head draws view synthesis: "brdf", by the recovered material and light, or "radiance", whose pictures know of
            neither. The fit is the same, and so is everything but view synthesis.
        radiance_steps: Adam steps of the radiance head alone.
        coarse_steps: Then steps of both heads on the coarse tensor.
        fine_steps: Then steps of both on the fine one.
        radiance_pixels: In every step of the first phase, from all training views.
        pixels: In every later step.
        directions: Of light of every pixel of a step, half of them in each of two independent renders.
        rendered_directions: Of a pixel of a render, shared out among its points.
        lobes: Spherical Gaussians of the light.
        coarse: Cells along a side of the tensor at first.
        fine: And in the last phase.
        components: Of every plane and line.
        tensor_rate: Adam rate of the tensor.
        network_rate: Adam rate of basis and heads.
        light_rate: Adam rate of the light's axes and of the logarithms of its sharpness and amplitude.
        brdf_weight: Weight of the image loss of the material's head, beside 1 of the radiance head.
        smooth_weight: Weight of the relative change of albedo and of roughness between points near by.
        variation_weight: Weight of the tensor's total variation in the first phase.
    """

    head: Literal["brdf", "radiance"] = "brdf"
    radiance_steps: Number = 400
    coarse_steps: Number = 400
    fine_steps: Count = 500
    radiance_pixels: Number = 512
    pixels: Number = 384
    directions: Number = 48
    rendered_directions: Number = 512
    lobes: Number = 128
    coarse: Annotated[int, Field(ge=2, le=2**31)] = 64  # one cell has no neighbour to be like
    fine: Number = 128
    components: Number = 16
    tensor_rate: Rate = 0.02
    network_rate: Rate = 0.003
    light_rate: Rate = 0.05
    brdf_weight: Weight = 10.0
    smooth_weight: Weight = 0.001
    variation_weight: Weight = 0.005

    def __post_init__(self) -> None:
        """Raises ValueError where the tensor would shrink."""
        if self.fine < self.coarse:
            raise ValueError(f"fine: expected at least coarse ({self.coarse}), found {self.fine}")


if TYPE_CHECKING:
    from ia_bench.methods.contract import Monitor, Problem, Result


class Tensoir:
    """A radiance head and a material head on one vector-matrix tensor, under a light of spherical Gaussians."""

    Options: ClassVar[type] = TensoirOptions
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "smoke": {
            "radiance_steps": 30,
            "coarse_steps": 25,
            "fine_steps": 5,
            "radiance_pixels": 512,
            "directions": 24,
            "rendered_directions": 128,
            "coarse": 16,
            "fine": 24,
        },
        "full": {"radiance_steps": 1600, "coarse_steps": 1600, "fine_steps": 2000},
        "paper": {
            "radiance_steps": 10_000,
            "coarse_steps": 10_000,
            "fine_steps": 60_000,
            "radiance_pixels": 4096,
            "pixels": 4096,
            "coarse": 128,
            "fine": 300,
            "components": 48,
            "network_rate": 0.001,
            "brdf_weight": 0.2,
            "light_rate": 0.001,
            "variation_weight": 0.00015,
        },
    }
    info = MethodInfo(uses_prior=False)

    def __init__(self, options: TensoirOptions) -> None:
        """``options``: see :class:`TensoirOptions`."""
        self.options = options

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        """Adam in three phases. Resumes from the monitor's checkpoint to the same numbers."""
        from ia_bench_baselines.tensoir.fit import fit

        return fit(problem, self.options, seed=seed, monitor=monitor)
