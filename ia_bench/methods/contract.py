"""What a method is given and what it gives back: the contract between a run and every way of reconstructing."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Protocol, runtime_checkable

import torch
from torch import Tensor

from ia_bench.methods.asking.settings import SupervisionSettings
from ia_bench.methods.costs import CostTracker
from ia_bench.methods.info import MethodInfo
from ia_bench.methods.photographs import Photographs
from ia_bench.methods.plan import Plan, make_plan
from ia_bench.priors.contract import Prior
from ia_bench.priors.none import NoPrior
from ia_bench.render.gbuffer import GBuffer
from ia_bench.render.reconstruction import Reconstruction
from ia_bench.render.renderer import Renderer
from ia_bench.render.settings import RenderSettings
from ia_bench.render.stage import Stage
from ia_bench.scenes.scene import Scene


@dataclass(frozen=True)
class Problem:
    """A scene without truth and, made once and only when asked for, what most methods want beside it.

    Attributes:
        scene: The mesh and the training images (all of one size), masks and cameras; nothing in it leads to truth.
        render: Settings of the renderer, as the user gave them.
        supervision: How the prior's predictions are to be used.
        device: Where tensors live.
        make_prior: Makes the prior that the run was asked to use, told what it is entitled to.
        truth: The scene with its truth, for a method that declares ``sees_truth``; None for all others.
        note: Takes one-line messages to the user.
        costs: Where seconds of baking are booked.
    """

    scene: Scene
    render: RenderSettings = field(default_factory=RenderSettings)
    supervision: SupervisionSettings = field(default_factory=SupervisionSettings)
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    make_prior: Callable[[Problem], Prior] = lambda _: NoPrior()
    truth: Scene | None = None
    note: Callable[[str], None] = warnings.warn
    costs: CostTracker = field(default_factory=CostTracker)

    @cached_property
    def stage(self) -> Stage:
        """The scene's mesh on the device, with whatever rendering it takes."""
        with self.costs.exclude("bake"):
            stage = Stage(self.scene.expect_mesh(), self.device)
            self.costs.watch(stage.counts)
            return stage

    @cached_property
    def plan(self) -> Plan:
        """The settings that were left to be chosen, measured on the scene; they are told as they are chosen."""
        with self.costs.exclude("bake"):
            wanted = self.supervision
            looking = self.prior.info.provides or wanted.refinement or wanted.roughness_refinement or wanted.parsimony
            plan = make_plan(self.scene, self.stage, self.render, prior_views=wanted.views if looking else None)
            for line in plan.lines():
                self.note(line)
            return plan

    @cached_property
    def gbuffer(self) -> GBuffer:
        """What the training cameras see, with as many points a pixel as the plan says."""
        with self.costs.exclude("bake"):
            return self.stage.gbuffer([view.camera for view in self.scene.train], self.plan.subsamples)

    @cached_property
    def photographs(self) -> Photographs:
        """What the training photographs show in the G-buffer's pixels."""
        return Photographs.of(self.scene, self.gbuffer)

    @cached_property
    def renderer(self) -> Renderer:
        """The renderer of the plan."""
        with self.costs.exclude("bake"):
            return self.stage.renderer(shadows=self.plan.shadows, bounces=self.plan.bounces, coat=self.render.coat)

    @cached_property
    def prior(self) -> Prior:
        """The prior, ready to be asked."""
        with self.costs.exclude("bake"):
            return self.make_prior(self)

    def pixels_of(self, images: Tensor) -> Tensor:
        """The G-buffer's pixels of stacked view images, (V, H, W, C) -> (P, C); ``gbuffer.images`` is the inverse."""
        return images.reshape(-1, images.shape[-1])[self.gbuffer.pixel]


@dataclass(frozen=True)
class Result:
    """What a method gives back.

    Attributes:
        reconstruction: What it recovered.
        seconds: By phase, whose names are the method's own; "prior" for what it asked one, or corrected. Baking and scoring
            are no part of it.
        counters: What a reader of the results should know of the fit, such as "network_calls".
        steps: How many steps it took, 0 for a method that takes none.
    """

    reconstruction: Reconstruction
    seconds: Mapping[str, float] = field(default_factory=dict)
    counters: Mapping[str, int] = field(default_factory=dict)
    steps: int = 0


class ProgressBar(Protocol):
    """One bar of the progress display."""

    def advance(self, amount: int = 1, **values: float) -> None:
        """Count ``amount`` steps and show ``values`` (the current loss, say)."""
        ...


class NoProgressBar:
    """A bar that nobody sees."""

    def advance(self, amount: int = 1, **values: float) -> None:
        """See :class:`ProgressBar`."""


@dataclass(frozen=True)
class Monitor:
    """How a method talks to the outside: progress, off-the-clock scoring, checkpoints.

    A method that raises before it begins a task with what it has loaded starts over without it.

    Attributes:
        task: Begins a bar of the display: its name, steps in all, steps already done.
        note: Takes one-line messages to the user.
        score: Takes phase, step, seconds so far, and what gives what is recovered so far; its time and rays are not counted.
        save: Keeps the state of the fit: tensors, numbers, texts, and lists and dicts of them.
        load: Gives back what was saved last by an interrupted process with the same configuration, or None.
        stopping: Says that the run is to end: the method saves at its next step, and ``save`` does not return.
        keep: Keeps a part of the state under a name until that name is kept again: what is large and seldom changes.
        kept: Gives back the part that belongs to the state that was loaded, or None.
        checkpoint_seconds: Time between two states that are saved.
    """

    task: Callable[[str, int, int], ProgressBar]
    note: Callable[[str], None]
    score: Callable[[str, int, float, Callable[[], Reconstruction]], None]
    save: Callable[[dict[str, Any]], None]
    load: Callable[[], dict[str, Any] | None]
    stopping: Callable[[], bool] = lambda: False
    keep: Callable[[str, dict[str, Any]], None] = lambda name, state: None
    kept: Callable[[str], dict[str, Any] | None] = lambda name: None
    checkpoint_seconds: float = 15.0

    @classmethod
    def silent(cls, **parts: Any) -> Monitor:  # noqa: ANN401 (what the attributes are)
        """A monitor that shows and keeps nothing, but for the ``parts`` that are given."""
        nothing = {name: lambda *_: None for name in ("note", "score", "save", "load")}
        return cls(**{"task": lambda *_: NoProgressBar(), **nothing, **parts})


@runtime_checkable
class Method(Protocol):
    """A way of reconstructing: a class that is made with its options.

    Importing it should not bring in torch: what identifies a run needs ``Options``, and nothing else of it.

    Attributes:
        Options: A dataclass of everything that ``method.options`` may set, with its types, ranges and defaults; pydantic checks
            it. A method ``memory(render)`` of it, if there is one, says how many bytes its settings take, by key.
        presets: Name of a preset -> the options that differ from their defaults.
        info: What the method says of itself.
    """

    Options: ClassVar[type]
    presets: ClassVar[Mapping[str, Mapping[str, Any]]]
    info: MethodInfo

    def __init__(self, options: Any) -> None:  # noqa: ANN401 (an instance of Options)
        """``options``: an instance of ``Options``."""
        ...

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        """Reconstruct from the training images. Deterministic in (problem, options, seed)."""
        ...
