"""What a method is given and what it gives back: the contract between run.py and every way of fitting."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import torch
from torch import Tensor

from ia_bench.material.textures import Material
from ia_bench.methods.plan import Plan
from ia_bench.methods.two_stage.settings import FitSettings, SupervisionSettings
from ia_bench.priors.contract import Prior
from ia_bench.render.gbuffer import GBuffer
from ia_bench.render.renderer import Renderer
from ia_bench.scenes.scene import Scene


@dataclass(frozen=True)
class Problem:
    """A scene without truth, its G-buffer over the training views, the renderer, the plan that sized them.

    ``supervision``: how the prior's predictions are to be used.
    """

    scene: Scene
    gbuffer: GBuffer
    renderer: Renderer
    plan: Plan
    supervision: SupervisionSettings = field(default_factory=SupervisionSettings)

    def pixels_of(self, images: Tensor) -> Tensor:
        """The G-buffer's pixels of stacked view images: (V, H, W, C) -> (P, C)."""
        return images.reshape(-1, images.shape[-1])[self.gbuffer.pixel]

    def images_of(self, pixels: Tensor) -> Tensor:
        """The inverse of :meth:`pixels_of`; pixels that miss the mesh are zero: (P, C) -> (V, H, W, C)."""
        images = torch.zeros(*self.gbuffer.shape, pixels.shape[-1], device=pixels.device)
        images.reshape(-1, pixels.shape[-1])[self.gbuffer.pixel] = pixels
        return images


@dataclass(frozen=True)
class Fit:
    """The result: ``material`` textures, ``light`` (H, W, 3) radiance, seconds per phase, counters worth recording.

    ``stage`` names the last row of the curve: "final", or "ceiling" where nothing was optimised.
    """

    material: Material
    light: Tensor
    seconds: dict[str, float] = field(default_factory=dict)
    counters: dict[str, int] = field(default_factory=dict)
    stage: str = "final"


class Task(Protocol):
    """One bar of the progress display."""

    def advance(self, amount: int = 1, **values: float) -> None:
        """Count ``amount`` steps and show ``values`` (the current loss, say)."""
        ...


@dataclass(frozen=True)
class Monitor:
    """How a method talks to the outside: progress, off-the-clock scoring, checkpoints.

    ``score(stage, step, seconds, fit)`` is called at geometrically spaced steps; its own time is not counted.
    ``save(state)`` and ``load()`` keep the state of an interrupted fit (tensors, numbers, strings, nested dicts and lists).
    A method that raises before it begins a task with what it has loaded starts over without it. ``stopping()`` says that the
    run is to end: the method saves at its next step, and ``save`` does not return. ``keep(name, state)`` writes a part of the
    state that does not change, once, instead of in every ``save``; ``kept(name)`` is that part after a ``load``, or None.
    """

    task: Callable[[str, int, int], Task]  # name, steps in all, steps already done
    note: Callable[[str], None]
    score: Callable[[str, int, float, Fit], None]
    save: Callable[[dict[str, Any]], None]
    load: Callable[[], dict[str, Any] | None]
    stopping: Callable[[], bool] = lambda: False
    keep: Callable[[str, dict[str, Any]], None] = lambda name, state: None
    kept: Callable[[str], dict[str, Any] | None] = lambda name: None


class Method(Protocol):
    """A way of recovering material and light; ``two_stage`` is ours, each baseline is another."""

    def fit(self, problem: Problem, prior: Prior, settings: FitSettings, *, seed: int, monitor: Monitor) -> Fit:
        """Recover material and light from the training images. Deterministic in (problem, prior, settings, seed)."""
        ...
