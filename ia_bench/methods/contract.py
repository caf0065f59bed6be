"""What a method is given and what it gives back: the contract between a run and every way of reconstructing."""

from __future__ import annotations

import gc
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, Protocol, runtime_checkable

import torch
from torch import Tensor

from ia_bench.common.exit_codes import log
from ia_bench.common.machine import return_memory
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.methods.info import HeldOut, MethodInfo
from ia_bench.methods.monitor import CostTracker, Monitor, Result
from ia_bench.methods.photographs import Photographs, evenly_spread
from ia_bench.methods.plan import Decision, Plan, choose_prior_views, make_plan
from ia_bench.priors.contract import NoPrior, Prior, PriorInfo, Samples
from ia_bench.render.gbuffer import GBuffer
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
        device: Where tensors live.
        make_prior: Makes the prior that the run was asked to use, told what it is entitled to.
        make_coupling: Makes the coupling that the run was asked to use, or that suits a prior of that info.
        prior_views: How many training views the prior is asked about, evenly spread; "all"; or "auto": as many as show the
            surface often enough. The image loss uses every view.
        keep_samples: Whether unguided samples of priors that have a fingerprint are kept between runs.
        truth: The scene with its truth, for a method that declares ``sees_truth``; None for all others.
        held_out: Names and cameras of the views that are scored, for a method that declares ``brought``; empty for all others.
        note: Takes one-line messages to the user.
        costs: Where seconds of baking are booked.
    """

    scene: Scene
    render: RenderSettings = field(default_factory=RenderSettings)
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    make_prior: Callable[[Problem], Prior] = lambda _: NoPrior()
    make_coupling: Callable[[PriorInfo], Coupling] = lambda _: NoCoupling()
    prior_views: int | str = "auto"
    keep_samples: bool = True
    truth: Scene | None = None
    held_out: HeldOut = field(default_factory=dict)
    note: Callable[[str], None] = log.warning
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
            plan = make_plan(self.scene, self.stage, self.render)
            for decision in plan.decisions:
                self.note(decision.line)
            return plan

    def settle(self, decision: Decision) -> None:
        """Put what a method has found out of a setting of the renderer into the plan, and tell it."""
        found, others = {decision.what.removeprefix("render."): decision.value}, self.plan.decisions
        kept = [one for one in others if one.what != decision.what]
        vars(self)["plan"] = replace(self.plan, **found, decisions=[*kept, decision])
        self.note(decision.line)

    @cached_property
    def gbuffer(self) -> GBuffer:
        """What the training cameras see, with as many points a pixel as the plan says."""
        with self.costs.exclude("bake"):
            found = self.stage.gbuffer([view.camera for view in self.scene.train], self.plan.subsamples)
            return_memory()  # as much as it takes itself, of its parts
            return found

    def forget_pixels(self) -> None:
        """Drop what is known of every pixel, gigabytes of large photographs; it is found again where somebody asks."""
        for name in ("gbuffer", "photographs"):
            vars(self).pop(name, None)
        gc.collect()  # a fit that is over has them, too, and holds itself
        return_memory()

    @cached_property
    def photographs(self) -> Photographs:
        """What the training photographs show in the G-buffer's pixels."""
        with self.costs.exclude("bake"):
            return Photographs.of(self.scene, self.gbuffer)

    @cached_property
    def renderer(self) -> Renderer:
        """The renderer of the plan."""
        with self.costs.exclude("bake"):
            settings = self.render
            return self.stage.renderer(
                shadows=self.plan.shadows, bounces=self.plan.bounces, coat=settings.coat, control_variate=settings.control_variate
            )

    @cached_property
    def prior(self) -> Prior:
        """The prior, ready to be asked."""
        with self.costs.exclude("bake"):
            return self.make_prior(self)

    @cached_property
    def coupling(self) -> Coupling:
        """How the fit is to use what the prior says."""
        with self.costs.exclude("bake"):
            return self.make_coupling(self.prior.info)

    @cached_property
    def asked_views(self) -> tuple[int, ...]:
        """The training views that the prior is asked about; the plan says how many, and why, once somebody wants to know."""
        with self.costs.exclude("bake"):
            decision = choose_prior_views(self.scene, self.stage, self.prior_views)
            self.plan.decisions.append(decision)
            self.note(decision.line)
            return evenly_spread(self.scene, decision.value)

    def pixels_of(self, images: Tensor) -> Tensor:
        """The G-buffer's pixels of stacked view images, (V, H, W, C) -> (P, C); ``gbuffer.images`` is the inverse."""
        return images.reshape(-1, images.shape[-1])[self.gbuffer.pixel]


# ---- couplings: from what a prior says to a loss ----------------------------------------------------------------


@dataclass(frozen=True)
class PixelSamples:
    """What a prior says of the G-buffer's P pixels.

    Attributes:
        values: (P, 3) per component: linear, premultiplied by coverage; zero in views that the prior was not asked about.
        weight: (P, 1), how much the pixel counts: even in the views that the prior was asked about, zero in others and where the
            photograph's mask leaves out what the mesh fills; mean 1, so that a loss keeps its weight however few views are asked.
        at_least: (P, 1) bool per component: where the prior could hardly have said more, a larger value is no error.
    """

    values: dict[str, Tensor]
    weight: Tensor
    at_least: dict[str, Tensor] = field(default_factory=dict)


@dataclass(frozen=True)
class StepRender:
    """What a step of a fit shows a coupling; gradients flow through all of it.

    Attributes:
        albedo: (B, 3), of the step's pixels, premultiplied by coverage.
        specular: (B, 3), their specular shading, linear.
        texture: (T, T, 3), the albedo texture, for a loss that is to move single texels alone: multigrid and
            scale-ambiguity steps do not follow its gradient.
        generator: Draws whatever is random in a loss.
    """

    albedo: Tensor
    specular: Tensor
    texture: Tensor
    generator: torch.Generator


class Coupling:
    """How a method turns what a prior says into a loss; made with ``coupling.options`` as keyword arguments.

    A subclass must define :meth:`prepare` and :meth:`loss`; built in are those of :mod:`ia_bench.methods.couplings`.

    Attributes:
        says_albedo: Whether what it makes of an albedo says which albedo a pixel has (up to its scale), and not only which pixels
            are alike: then photographs alone do not decide the albedo when all steps are done.
        sets_albedo: Whether a fit may start from the prior's albedo.
        period: 0: the prior is sampled before the fit, and again, guided by the renders, before its second stage. More: it is
            asked every ``period`` steps to denoise renders of ``views`` of its views (``Distiller``).
        views: See ``period``.
    """

    says_albedo: ClassVar[bool] = False
    sets_albedo: bool = False
    period: int = 0
    views: int = 0

    def uses(self, provides: frozenset[str]) -> frozenset[str]:
        """The components, of those that a prior ``provides``, that have a weight; a prior is not asked for the sake of others."""
        return provides

    def prepare(self, samples: PixelSamples, problem: Problem) -> None:
        """Take over new samples, in place of former ones."""
        raise NotImplementedError

    def loss(self, render: StepRender, pixels: Tensor) -> dict[str, Tensor]:
        """The weighted losses, by name, of a step's G-buffer entries (B,)."""
        raise NotImplementedError

    def update(self, texture: Tensor, step: int) -> None:
        """Called before each :meth:`loss` with the albedo texture (T, T, 3), which is not to be changed."""

    def state(self) -> dict[str, Tensor]:
        """What a checkpoint must keep beside the samples."""
        return {}

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take over a :meth:`state`, after :meth:`prepare`. Its tensors are on the CPU, wherever they were."""


class NoCoupling(Coupling):
    """``coupling=none``: whatever the prior says has no influence on the steps, and it is not asked for it."""

    def uses(self, provides: frozenset[str]) -> frozenset[str]:
        """Nothing."""
        return frozenset()


# ---- regularisers: what changes a material between steps and after them --------------------------------------------


@dataclass(frozen=True)
class FitState:
    """What a regulariser is told of a fit, beside its material.

    Attributes:
        problem: The problem of the fit; its ``asked_views`` are those that a prior is asked about.
        light: As recovered so far.
        exposures: The factors (V, 1), or (V, 3) by channel, by which photographs were exposed; None where they are the same.
        observed: (T, T) bool, texels that some photograph shows.
        generator: Draws whatever is random.
        refine: Asks the prior to correct a fit's renders (:meth:`ia_bench.priors.contract.Refiner.refine`); raises InputError for
            one that cannot.
    """

    problem: Problem
    light: SampledLight
    exposures: Tensor | None
    observed: Tensor
    generator: torch.Generator
    refine: Callable[[dict[str, Tensor]], Samples]


class Regulariser:
    """What changes albedo and roughness by itself, between steps or after them; ``fit.regulariser_options`` are its arguments.

    A subclass must define :meth:`apply`; built in are those of :mod:`ia_bench.methods.regularisers`.

    Attributes:
        completes: Whether it guesses what photographs hardly show: it is applied to the finished material, in which texels that no
            photograph shows have been filled from their neighbours. One that does not is given all as it was fitted.
    """

    completes: bool = False

    def prepare(self, problem: Problem) -> None:
        """Called before a fit begins; raises InputError where it cannot be applied."""

    def due(self, step: int, steps: int) -> bool:
        """Whether it is applied after ``step`` of ``steps``, once the albedo is optimised; ``step == steps`` is the last.

        The albedo may be solved for after that (``fit.solve_albedo``). One that completes is not asked.
        """
        return step == steps

    def apply(self, material: Material, state: FitState) -> Material:
        """A material instead of ``material``, whose metallic stays; the fit brings values back into their range."""
        raise NotImplementedError


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
