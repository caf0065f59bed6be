"""Do a coupling and a regulariser keep their contracts (:mod:`ia_bench.methods.contract`)? One finding per question.

Both are asked about a problem as a run makes it, of materials and samples that are made up: they are judged by what they do.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import torch
from torch import Tensor

from ia_bench.checks.finding import Finding, guarded, judge, other_chance
from ia_bench.common.errors import InputError, PluginError
from ia_bench.common.registry import Kind
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.methods.contract import Coupling, FitState, PixelSamples, Problem, Regulariser, StepRender
from ia_bench.methods.validation import checked_part
from ia_bench.priors.contract import COMPONENTS, Samples

PIXELS = 512  # of a step
SIDE, STEPS = 32, 100  # texels of the material, steps of the fit
AN_ANSWER = "an answer as the contract describes it"


def check_part(kind: Kind, make: Callable[[], Any], problem: Problem) -> Iterator[Finding]:
    """Check the coupling or regulariser that ``make()`` returns; an instance for every question. Never raises for what it does."""

    def answers() -> Iterator[Finding]:
        made, (contract, rules) = make(), RULES[kind]
        sound = isinstance(made, contract)
        yield judge(sound, "construction", f"a {contract.__module__}.{contract.__name__}", type(made).__name__)
        if sound:
            yield from rules(lambda: checked_part(kind, type(made).__qualname__, make()), problem)

    return guarded("a question", AN_ANSWER, answers)


def _coupling(new: Callable[[], Coupling], problem: Problem) -> Iterator[Finding]:
    coupling = new()
    uses = coupling.uses(frozenset(COMPONENTS))
    yield Finding("pass", "what it uses", "", f"{', '.join(sorted(uses)) or 'nothing'} of {', '.join(COMPONENTS)}")
    none = coupling.uses(frozenset())
    yield judge(not none, "a prior that provides nothing", "nothing used", ", ".join(none) or "nothing")
    if not uses:
        yield Finding("skip", "losses", "", "it uses nothing, so it is never asked for any")
        return
    radiance = problem.photographs.radiance
    asked = (torch.arange(len(radiance)) >= len(radiance) // 5).float()[:, None]  # a prior is not asked about every view
    values = {"albedo": asked * (0.4 * radiance).clamp(0, 1), "specular": asked * 0.1 * radiance}
    samples = PixelSamples(values, asked / asked.mean())
    kept = {name: value.clone() for name, value in values.items()}
    coupling.prepare(samples, problem)
    pixels = torch.linspace(0, len(radiance) - 1, PIXELS).long()
    number = itertools.count()

    def losses_of(one: Coupling) -> tuple[dict[str, Tensor], list[Tensor], bool]:
        with other_chance(next(number)):
            return _losses(one, samples, pixels)

    before = coupling.state()
    first, gradients, untouched = losses_of(coupling)
    said = ", ".join(f"{name} {float(value):.3g}" for name, value in first.items()) or "none"
    sound = all(bool(torch.isfinite(part).all()) for part in (*first.values(), *gradients))
    yield judge(sound, "losses", "finite values, and gradients", said)
    moved = any(bool(part.any()) for part in gradients)
    yield judge(moved, "gradient", "losses that the render moves", "a gradient" if moved else "none")
    coupling.restore(before)  # it may count how often it was asked
    yield _same("the same generator again", first, losses_of(coupling)[0])
    other = new()
    other.prepare(samples, problem)
    other.restore(coupling.state())
    yield _same("killed and resumed", losses_of(coupling)[0], losses_of(other)[0])
    same = all(torch.equal(values[name], kept[name]) for name in kept)
    yield judge(same, "samples", "nothing modified", "" if same else "modified")
    yield judge(untouched, "the albedo texture", "nothing modified", "" if untouched else "modified")
    for name in COMPONENTS:
        yield from guarded(f"a prior of {name} alone", AN_ANSWER, partial(_alone, new(), name, samples, problem, pixels))


def _alone(coupling: Coupling, name: str, samples: PixelSamples, problem: Problem, pixels: Tensor) -> Iterator[Finding]:
    """What the coupling makes of a prior that provides one component."""
    what = f"a prior of {name} alone"
    if not coupling.uses(frozenset({name})):
        yield Finding("pass", what, "", "nothing used")
        return
    coupling.prepare(replace(samples, values={name: samples.values[name]}), problem)
    losses, gradients, _ = _losses(coupling, samples, pixels)
    sound = all(bool(torch.isfinite(part).all()) for part in (*losses.values(), *gradients))
    yield judge(sound, what, "finite losses, and gradients", ", ".join(losses) or "nothing used")


def _losses(coupling: Coupling, samples: PixelSamples, pixels: Tensor) -> tuple[dict[str, Tensor], list[Tensor], bool]:
    """The losses of a render that is near the samples, and their gradients by albedo, specular shading and texture.

    And whether the texture, which is the fit's own in a run, is as it was.
    """
    generator = torch.Generator().manual_seed(0)
    given = {name: (0.8 * samples.values[name][pixels] + 0.02).requires_grad_() for name in COMPONENTS}
    texture = (0.3 + 0.2 * torch.rand(SIDE, SIDE, 3, generator=generator)).requires_grad_()
    before = texture.detach().clone()
    coupling.update(texture.detach(), 0)
    losses = coupling.loss(StepRender(given["albedo"], given["specular"], texture, generator), pixels)
    total = sum(losses.values(), torch.zeros(()))
    inputs = [*given.values(), texture]
    found = torch.autograd.grad(total, inputs, allow_unused=True) if total.requires_grad else ()
    untouched = torch.equal(texture, before)
    return {name: value.detach() for name, value in losses.items()}, [part for part in found if part is not None], untouched


def _regulariser(new: Callable[[], Regulariser], problem: Problem) -> Iterator[Finding]:
    regulariser = new()
    try:
        regulariser.prepare(problem)
    except PluginError:  # which it has raised without saying that it cannot
        raise
    except InputError as error:
        yield Finding("skip", "everything else", "", f"it cannot be applied here: {error}")
        return
    due = [step for step in range(1, STEPS + 1) if regulariser.due(step, STEPS)]
    when = "it completes the finished material" if regulariser.completes else f"{len(due)} times in {STEPS} steps"
    yield judge(bool(due) or regulariser.completes, "when it is due", "some step, or the end", when)
    generator = torch.Generator().manual_seed(0)
    material = Material(torch.rand(SIDE, SIDE, 3, generator=generator), 0.2 + 0.6 * torch.rand(SIDE, SIDE, 1, generator=generator))
    before = material.albedo.clone(), material.roughness.clone()
    other = new()
    other.prepare(problem)
    observed = torch.arange(SIDE)[:, None].expand(SIDE, SIDE) < SIDE // 2  # a fit of which the upper half of the texture is seen

    def refine(renders: dict[str, Tensor]) -> Samples:  # of a prior that corrects everything to a half
        return Samples({name: 0.5 * renders[name] for name in ("albedo", "roughness")})

    def applied(one: Regulariser, number: int) -> Material:
        light = SampledLight.of(torch.ones(8, 16, 3))
        with other_chance(number), torch.no_grad():
            return one.apply(material, FitState(problem, light, None, observed, torch.Generator().manual_seed(0), refine))

    moved, again, another = map(applied, (regulariser, regulariser, other), range(3))
    change = float((moved.albedo - material.albedo).abs().mean())
    yield Finding("pass", "a material", "", f"as large as before, finite; albedo moves by {change:.2g} in the mean")
    same = torch.equal(material.albedo, before[0]) and torch.equal(material.roughness, before[1])
    yield judge(same, "the material that it was given", "nothing modified", "" if same else "modified")
    yield _same("the same generator again", vars(moved), vars(again))
    yield _same("another instance", vars(moved), vars(another))


def _same(what: str, first: dict[str, Any], again: dict[str, Any]) -> Finding:
    differing = [name for name, value in first.items() if isinstance(value, Tensor) and not torch.equal(value, again[name])]
    return judge(not differing, what, "the same to the bit", ", ".join(differing) + " differ" if differing else "")


RULES: dict[Kind, tuple[type, Callable[[Callable[[], Any], Problem], Iterator[Finding]]]] = {
    "coupling": (Coupling, _coupling),
    "regulariser": (Regulariser, _regulariser),
}
"""By kind: the contract, and the questions to what keeps it."""
