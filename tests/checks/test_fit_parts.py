"""The checks of couplings and regularisers: those that come with the package pass, and each way of breaking a contract is named."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from ia_bench.checks.finding import Finding
from ia_bench.checks.fit_parts import check_part
from ia_bench.common import registry
from ia_bench.common.errors import InputError
from ia_bench.material.textures import Material
from ia_bench.methods.contract import Coupling, FitState, NoCoupling, PixelSamples, Problem, Regulariser, StepRender
from ia_bench.render.settings import RenderSettings
from ia_bench.scenes.scene import Scene


@pytest.fixture(scope="module")
def problem(tiny: Scene) -> Problem:
    return Problem(tiny.blind(), RenderSettings(bounces=0))


def crosses(findings: Any) -> list[str]:
    found: list[Finding] = list(findings)
    return [f"{finding.what}: {finding.found}" for finding in found if finding.status == "fail"]


@pytest.mark.parametrize("name", sorted(set(registry.built_in("coupling")) - {"auto"}))
def test_couplings_of_the_package_keep_their_contract(name: str, problem: Problem) -> None:
    assert crosses(check_part("coupling", lambda: registry.load(registry.find("coupling", name))(), problem)) == []


@pytest.mark.parametrize("name", ["context", "parsimony", "symmetry"])
def test_regularisers_of_the_package_keep_their_contract(name: str, problem: Problem) -> None:
    assert crosses(check_part("regulariser", lambda: registry.load(registry.find("regulariser", name))(), problem)) == []


class Level(Coupling):
    """Draws the albedo to the mean of the prior's."""

    def uses(self, provides: frozenset[str]) -> frozenset[str]:
        return provides & {"albedo"}

    def prepare(self, samples: PixelSamples, problem: Problem) -> None:
        self.mean = samples.values["albedo"].mean(0)

    def loss(self, render: StepRender, pixels: Tensor) -> Any:
        return {"level": (render.albedo.mean(0) - self.mean).square().sum()}


class Paints(Level):
    def prepare(self, samples: PixelSamples, problem: Problem) -> None:
        super().prepare(samples, problem)
        samples.values["albedo"].zero_()


class Quotient(Level):
    """Divides by the prior's albedo, which is 0 in views that it was not asked about."""

    def prepare(self, samples: PixelSamples, problem: Problem) -> None:
        self.albedo, self.weight = samples.values["albedo"], samples.weight

    def loss(self, render: StepRender, pixels: Tensor) -> Any:
        return {"quotient": (self.weight[pixels] * render.albedo / self.albedo[pixels]).mean()}


class Drawn(Level):
    """Chooses pixels by the generator of the whole process."""

    def loss(self, render: StepRender, pixels: Tensor) -> Any:
        return {"drawn": (render.albedo[torch.rand(len(pixels)) < 0.5] - self.mean).square().sum()}


class Counts(Level):
    steps = 0

    def update(self, texture: Tensor, step: int) -> None:
        Counts.steps += 1

    def loss(self, render: StepRender, pixels: Tensor) -> Any:
        return {"level": self.steps * super().loss(render, pixels)["level"]}


class Fades(Level):
    """Weighs less with every step, which a checkpoint keeps."""

    steps = 0

    def update(self, texture: Tensor, step: int) -> None:
        self.steps += 1

    def loss(self, render: StepRender, pixels: Tensor) -> Any:
        return {"level": super().loss(render, pixels)["level"] / (1 + self.steps)}

    def state(self) -> dict[str, Tensor]:
        return {"steps": torch.tensor(self.steps)}

    def restore(self, state: dict[str, Tensor]) -> None:
        self.steps = int(state["steps"])


def test_a_coupling_may_keep_account_of_its_steps(problem: Problem) -> None:
    assert crosses(check_part("coupling", Fades, problem)) == []


class Single(Coupling):
    """Divides by the other component, which a prior of one alone has not."""

    def prepare(self, samples: PixelSamples, problem: Problem) -> None:
        self.parts = len(samples.values)

    def loss(self, render: StepRender, pixels: Tensor) -> Any:
        return {"mean": render.albedo.mean() / (self.parts - 1)}


def changed(kind: type, **members: object) -> type:
    return type("Broken", (kind,), members)


@pytest.mark.parametrize(
    ("broken", "cross"),
    [
        (dict, "construction: dict"),
        (changed(Coupling), "coupling Broken: prepare(): expected a method of its own, found none"),
        (changed(Level, loss=lambda self, render, pixels: 0), "coupling Broken: loss(): expected a mapping"),
        (changed(Level, loss=lambda self, render, pixels: {"a": render.albedo.mean() / 0}), "losses: a inf"),
        (changed(Level, loss=lambda self, render, pixels: {}), "gradient: none"),
        (changed(Level, uses=lambda self, provides: {"albedo"}), "uses(): expected a frozenset of some of albedo, specular"),
        (changed(Level, uses=lambda self, provides: frozenset({"albedo"})), "uses(): expected an empty frozenset, found"),
        (changed(Level, period=2.5), "coupling Broken: period: expected a whole number >= 0, found 2.5"),
        (changed(Level, views=-1), "coupling Broken: views: expected a whole number >= 0, found -1"),
        (changed(Level, period=3), "coupling Broken: views: expected 1 or more of one that asks again every 3 steps, found 0"),
        (changed(Level, views=lambda self: 1), "coupling Broken: views: expected a whole number >= 0, found <bound method"),
        (changed(Level, sets_albedo="albedo"), "coupling Broken: sets_albedo: expected True or False, found 'albedo'"),
        (changed(Level, state=lambda self: {"mean": self.mean.numpy()}), "state(): expected a mapping of names to tensors"),
        (Counts, "the same generator again: level differ"),
        (Drawn, "the same generator again: drawn differ"),
        (Quotient, "losses: quotient nan"),
        (changed(Level, uses=lambda self, it: it), "a prior of specular alone: PluginError: coupling Broken raised KeyError"),
        (Single, "a prior of albedo alone: mean"),
        (Paints, "samples: modified"),
        (changed(Level, update=lambda self, texture, step: texture.mul_(0.5)), "the albedo texture: modified"),
    ],
)
def test_what_breaks_the_contract_of_couplings_is_named(broken: type, cross: str, problem: Problem) -> None:
    assert any(cross in found for found in crosses(check_part("coupling", broken, problem)))


class Darker(Regulariser):
    """A hundredth less albedo."""

    def apply(self, material: Material, state: FitState) -> Material:
        return replace(material, albedo=0.99 * material.albedo)


class Dims(Regulariser):
    """Darker by chance, of the generator of the whole process."""

    def apply(self, material: Material, state: FitState) -> Material:
        return replace(material, albedo=material.albedo * torch.rand(()))


class Inside(Regulariser):
    def apply(self, material: Material, state: FitState) -> Material:
        material.albedo.mul_(0.99)
        return material


class Noisy(Darker):
    """Paints noise of its own, and not of the state's generator."""

    draws = torch.Generator().manual_seed(5)

    def apply(self, material: Material, state: FitState) -> Material:
        return replace(material, albedo=torch.rand(32, 32, 3, generator=self.draws))


@pytest.mark.parametrize(
    ("broken", "cross"),
    [
        (NoCoupling, "construction: NoCoupling"),
        (changed(Regulariser), "regulariser Broken: apply(): expected a method of its own, found none"),
        (Dims, "the same generator again: albedo differ"),
        (changed(Darker, apply=lambda self, material, state: None), "apply(): expected a ia_bench.material"),
        (changed(Darker, completes=None), "regulariser Broken: completes: expected True or False, found None"),
        (changed(Darker, due=lambda self, step, steps: None), "regulariser Broken: due(): expected True or False, found None"),
        (changed(Darker, due=lambda self, step, steps: False), "when it is due: 0 times in 100 steps"),
        (changed(Darker, apply=lambda self, m, state: replace(m, albedo=m.albedo / 0)), "albedo: expected finite values"),
        (changed(Darker, prepare=lambda self, problem: problem.symmetry), "AttributeError: 'Problem' object has no attribute"),
        (Noisy, "again: albedo differ"),
        (Inside, "the material that it was given: modified"),
    ],
)
def test_what_breaks_the_contract_of_regularisers_is_named(broken: type, cross: str, problem: Problem) -> None:
    assert crosses(check_part("regulariser", Darker, problem)) == []
    assert any(cross in found for found in crosses(check_part("regulariser", broken, problem)))


def test_one_that_cannot_be_applied_here_is_no_fault(problem: Problem) -> None:
    class Choosy(Darker):
        def prepare(self, problem: Problem) -> None:
            raise InputError("expected a scene of glass")

    found = list(check_part("regulariser", Choosy, problem))
    assert [finding.status for finding in found] == ["pass", "skip"]
    assert "expected a scene of glass" in found[-1].found
