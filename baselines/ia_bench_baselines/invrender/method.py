"""InvRender (Zhang et al. 2022) on a given mesh, without its signed distance field and with traced visibility."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from ia_bench.common.ranges import Count, Number, Positive, Rate, Weight
from ia_bench.methods.info import MethodInfo


@dataclass(frozen=True)
class InvRenderOptions:
    """What the original has otherwise is in card.md.

    Attributes:
        radiance_steps: Adam steps of the radiance field, which says what parts of the object send to each other.
        indirect_steps: Adam steps of the indirect light's spherical Gaussians; 0 leaves indirect light out.
        steps: Adam steps of material and light.
        pixels: Training pixels of a step, of all views.
        texels: Surface points of a step of the indirect light.
        width: Of the hidden layers of all networks but the decoder.
        octaves: Of the encoding of positions; the last one's period is 2 pi / 2^(octaves - 1) of half the object's extent: with 7
            about five pixels where the object fills an image of 128, as with the original's 10 in one of 800.
        network_rate: Adam rate of networks.
        light_rate: Adam rate of the light's axes and of the logarithms of its sharpness and amplitude.
        final_rate: What the rates fall to over a phase, as a fraction.
        sparsity: Weight of the divergence that keeps latent codes sparse.
        smoothness: Weight of the change of the material where its latent code is perturbed.
        directions: Over the sphere, in which what every texel of the atlas sees of the object is traced once, for indirect light.
        atlas: Texels along a side of the atlas of points that indirect light is known at.
        texture: Texels along a side of the textures that the material is written to.
    """

    radiance_steps: Number = 800
    indirect_steps: Count = 400
    steps: Number = 2600
    pixels: Number = 512
    texels: Number = 256
    width: Number = 128
    octaves: Number = 7
    network_rate: Rate = 4e-3
    light_rate: Rate = 0.05
    final_rate: Positive = 0.1
    sparsity: Weight = 0.01
    smoothness: Weight = 0.1
    directions: Number = 256
    atlas: Number = 128
    texture: Number = 512


if TYPE_CHECKING:
    from ia_bench.methods.contract import Monitor, Problem, Result


class InvRender:
    """Adam on a sparse latent material and 128 spherical Gaussians, shaded in closed form; card.md says what differs."""

    Options: ClassVar[type] = InvRenderOptions
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "smoke": {"radiance_steps": 8, "indirect_steps": 4, "steps": 8, "atlas": 32, "directions": 64, "texture": 64},
        "full": {"radiance_steps": 3200, "indirect_steps": 1600, "steps": 10_400},
        "paper": {
            "radiance_steps": 200000,
            "indirect_steps": 10000,
            "steps": 10000,
            "pixels": 1024,
            "width": 512,
            "octaves": 10,
            "network_rate": 5e-4,
        },
    }
    info = MethodInfo(uses_prior=False)

    def __init__(self, options: InvRenderOptions) -> None:
        """``options``: see :class:`InvRenderOptions`."""
        self.options = options

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        """Three phases of Adam. Resumes from the monitor's checkpoint to the same numbers.

        Raises InputError where no training pixel shows the object alone.
        """
        from ia_bench.methods.descent import Descent
        from ia_bench_baselines.invrender.fitting import Fitting

        with problem.costs.exclude("bake"):
            fitting = Fitting(problem, self.options, seed)
        return Descent(fitting.model, fitting.phases(), seed=seed, monitor=monitor).run(fitting.recovered)
