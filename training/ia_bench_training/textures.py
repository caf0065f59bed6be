"""Procedural materials: albedo and roughness as functions of the place in a part.

A pattern (:mod:`ia_bench_training.patterns`) maps points to a value in [0, 1]; a colour ramp maps the value to albedo; layers are
put on top of each other through masks, which are patterns too. All draws are made when a material is drawn, so that it is a pure
function after.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.random import Generator
from torch import Tensor

from ia_bench_training.draws import log_uniform
from ia_bench_training.noise import fractal
from ia_bench_training.palettes import MAX_ALBEDO, MIN_ALBEDO, palette
from ia_bench_training.patterns import Pattern, draw_pattern


@dataclass(frozen=True)
class _Layer:
    colours: Tensor  # (K, 3) along the ramp
    stepped: bool
    pattern: Pattern | None  # None: the first colour everywhere
    mask: Pattern | None  # None: everywhere


@dataclass(frozen=True)
class TexturedMaterial:
    """Albedo and perceptual roughness of one part; both are pure functions of the place."""

    layers: tuple[_Layer, ...]
    scale: float
    variation: float
    shift: Tensor
    roughness: float
    roughness_other: float
    roughness_pattern: Pattern | None

    def __call__(self, local: Tensor, axis: Tensor) -> tuple[Tensor, Tensor]:
        """Albedo (N, 3) in [0.02, 0.95] and roughness (N, 1) in [0.05, 1] at local points (N, 3) with dominant axes (N,)."""
        p = local * self.scale
        albedo = self.layers[0].colours[:1].expand(len(p), 3)
        for layer in self.layers:
            colour = _ramp(layer, p, axis)
            albedo = colour if layer.mask is None else albedo + layer.mask(p, axis)[:, None] * (colour - albedo)
        if self.variation:  # nothing real is of one colour: slow changes of lightness and, less so, of hue
            change = fractal(p * 2 + self.shift, 4)
            albedo = albedo * torch.exp(self.variation * (change[:, :1] + 0.25 * change[:, 1:]))
        roughness = torch.full((len(p), 1), self.roughness)
        if self.roughness_pattern is not None:
            mix = self.roughness_pattern(p, axis)[:, None]
            roughness = roughness + mix * (self.roughness_other - roughness)
        return albedo.clamp(MIN_ALBEDO, MAX_ALBEDO), roughness.clamp(0.05, 1)

    def overlaid(self, other: TexturedMaterial, rng: Generator) -> TexturedMaterial:
        """This material with the layers of ``other`` on top, each through its mask, or one that is drawn here: a print on cloth."""
        masked = [replace(layer, mask=layer.mask or draw_pattern(rng)) for layer in other.layers]
        return replace(self, layers=(*self.layers, *masked))


def _ramp(layer: _Layer, p: Tensor, axis: Tensor) -> Tensor:
    if layer.pattern is None:
        return layer.colours[:1].expand(len(p), 3)
    last = len(layer.colours) - 1
    at = layer.pattern(p, axis).clamp(0, 1) * last
    below = at.floor().clamp(max=last - 1)
    part = (at - below)[:, None]
    if layer.stepped:
        part = part.round()
    index = below.long()
    return layer.colours[index] * (1 - part) + layer.colours[index + 1] * part


def _draw_layer(rng: Generator, colours: np.ndarray, mask: Pattern | None, plain: float) -> _Layer:
    count = int(rng.integers(2, 5))
    chosen = torch.from_numpy(colours[rng.permutation(len(colours))[:count]]).float()  # no colour twice: contrast
    pattern = None if rng.random() < plain else draw_pattern(rng)
    return _Layer(chosen, bool(rng.random() < 0.3), pattern, mask)


def draw_roughness(rng: Generator) -> float:
    """Draw a perceptual roughness: glossy, satin or matt."""
    low, high = [(0.05, 0.3), (0.3, 0.6), (0.6, 1.0)][rng.choice(3, p=[0.25, 0.45, 0.3])]
    return float(rng.uniform(low, high))


def draw_material(rng: Generator, colours: np.ndarray) -> TexturedMaterial:
    """A material from a palette (K, 3): one to three layers, a tenth of them of one colour only."""
    layers = [_draw_layer(rng, colours, None, 0.2)]
    for _ in range(int(rng.choice([0, 1, 2], p=[0.5, 0.38, 0.12]))):
        layers.append(_draw_layer(rng, colours, draw_pattern(rng), 0.6))
    return TexturedMaterial(
        layers=tuple(layers),
        scale=log_uniform(rng, 0.6, 1.6),
        variation=float(rng.choice([0.0, 0.04, 0.1, 0.25], p=[0.25, 0.35, 0.25, 0.15])),
        shift=torch.from_numpy(rng.uniform(0, 30, 3)).float(),
        roughness=draw_roughness(rng),
        roughness_other=draw_roughness(rng),
        roughness_pattern=draw_pattern(rng) if rng.random() < 0.3 else None,
    )


def draw_materials(rng: Generator, slots: int) -> list[TexturedMaterial]:
    """Materials of an object's slots. Half of the objects keep to one palette, so that their colours belong together."""
    shared = palette(rng, 6)
    together = rng.random() < 0.5
    return [draw_material(rng, shared if together else palette(rng, 5)) for _ in range(slots)]
