"""Which coupling a run uses, and what those that come with the package share: weights, and how specular shading is compared."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ia_bench.common import registry
from ia_bench.common.errors import PluginError, unknown
from ia_bench.common.ranges import Weight
from ia_bench.material.textures import fetch
from ia_bench.methods.contract import Coupling, NoCoupling, PixelSamples, Problem, StepRender
from ia_bench.methods.info import AUTO
from ia_bench.methods.validation import checked_part
from ia_bench.priors.contract import PriorInfo
from ia_bench.scenes.color import linear_to_srgb, tone_map

DEFAULT = "kernel"
"""What a prior is coupled by that recommends nothing, built in or not."""


def coupling_of(
    info: PriorInfo, name: str, target: str | None, options: Mapping[str, Any], note: Callable[[str], None]
) -> Coupling:
    """The coupling called ``name``; "auto" is what the prior's ``info`` recommends, or the DEFAULT. Which it is, is told.

    Raises InputError for one that is not there or cannot be made, PluginError where a prior recommends none that is there.
    """
    if not info.provides:
        if name not in (AUTO, "none"):
            note(f"coupling: {name} has nothing to use, since the prior says nothing")
        return NoCoupling()
    why = "as it was set"
    if name == AUTO:
        name, why = (info.coupling, "which the prior recommends") if info.coupling else (DEFAULT, "the default")
        target = None
        if info.coupling and name not in (known := {**registry.built_in("coupling"), **registry.installed("coupling")}):
            raise PluginError(f"the prior recommends an {unknown('coupling', name, known)}")
    made = registry.create("coupling", name, target or registry.find("coupling", name).target, options)
    coupling: Coupling = checked_part("coupling", name, made)
    used = ", ".join(sorted(coupling.uses(info.provides))) or "nothing"
    note(f"coupling: {name}, {why}; it uses {used} of the prior's {', '.join(sorted(info.provides))}")
    return coupling


def encode(linear: Tensor, encoding: str) -> Tensor:
    """Linear values in a prior's ``encoding``, "linear" or "srgb"."""
    return linear_to_srgb(linear) if encoding == "srgb" else linear


def shown(texture: Tensor, pixels: Tensor, problem: Problem) -> Tensor:
    """What G-buffer entries (B,) show of a texture (T, T, C): means (B, C) over their points, of which a miss is black."""
    uv, hit = points_of(pixels, problem)
    return (fetch(texture, uv) * hit[..., None]).mean(1)


def points_of(pixels: Tensor, problem: Problem) -> tuple[Tensor, Tensor]:
    """Texture coordinates (B, S, 2) of the points of G-buffer entries (B,), and which of them the object has (B, S)."""
    gbuffer = problem.gbuffer
    face = gbuffer.face[pixels]
    return problem.renderer.surface.uv(face.clamp_min(0).long(), gbuffer.barycentric[pixels]), face >= 0


def per_view(values: Tensor, view: Tensor, views: int) -> Tensor:
    """Means (V,) of the values (P, 3) in views (P,); 0 for a view without any."""
    zeros = values.new_zeros(views)
    count = zeros.index_add(0, view, torch.ones_like(values[:, 0])).clamp_min(1)
    return zeros.index_add(0, view, values.mean(-1)) / count


@dataclass(eq=False)
class WeightedCoupling(Coupling):
    """The loss ``albedo`` * :meth:`albedo_loss` + ``specular`` * :meth:`specular_loss` of what a prior provides.

    Attributes:
        albedo: Weight of what the prior says of albedo.
        specular: Weight of what it says of specular shading.
    """

    albedo: Weight = 1.0
    specular: Weight = 1.0

    def uses(self, provides: frozenset[str]) -> frozenset[str]:
        """Those with a weight above 0."""
        return frozenset(name for name in provides if getattr(self, name))

    def prepare(self, samples: PixelSamples, problem: Problem) -> None:
        """Encode once what every step compares with."""
        self._weight, self._at_least = samples.weight, samples.at_least
        self._unit, self._encoding = problem.photographs.unit, problem.prior.info.encoding
        self._said = {name: self._encoded(name, values) for name, values in samples.values.items()}
        self._uses = self.uses(frozenset(samples.values))

    def loss(self, render: StepRender, pixels: Tensor) -> dict[str, Tensor]:
        """See the class; "albedo" and "specular", as far as they have a weight."""
        losses = {"albedo": self.albedo_loss, "specular": self.specular_loss}
        return {name: getattr(self, name) * loss(render, pixels) for name, loss in losses.items() if name in self._uses}

    def albedo_loss(self, render: StepRender, pixels: Tensor) -> Tensor:
        """What the albedo at G-buffer entries (B,) is compared by, without its weight."""
        raise NotImplementedError

    def specular_loss(self, render: StepRender, pixels: Tensor) -> Tensor:
        """|S_hat - S_s| of tone-mapped radiance: highlights span orders of magnitude, their log does not."""
        return (self._weight[pixels] * self._difference("specular", render.specular, pixels).abs()).mean()

    def _difference(self, name: str, linear: Tensor, pixels: Tensor) -> Tensor:
        """How far ``linear`` values (B, 3) are from what the prior says of G-buffer entries (B,), both encoded.

        Where the prior could hardly have said more, since it sees nothing brighter than its white, only what falls short counts.
        """
        found = self._encoded(name, linear) - self._said[name][pixels]
        return torch.where(self._at_least[name][pixels], found.clamp(max=0), found) if name in self._at_least else found

    def _encoded(self, name: str, linear: Tensor) -> Tensor:
        return encode(linear, self._encoding[name]) if name == "albedo" else tone_map(self._unit * linear)
