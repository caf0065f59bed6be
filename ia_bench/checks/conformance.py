"""Does a prior keep the contract of :mod:`ia_bench.priors.contract`? One finding per question, with what was found.

A prior is judged by what it does: every rule samples it on small posed images, under the settings of a run. A prior that
wants truth is shown it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ia_bench.checks.finding import Finding, judge
from ia_bench.checks.stack import Stack, painted_ball
from ia_bench.checks.subject import GEOMETRY, Images, Subject, check_members
from ia_bench.common.errors import InputError, raised
from ia_bench.common.process_state import process_state_kept
from ia_bench.priors.contract import COMPONENTS, Samples
from ia_bench.priors.validation import checked, checked_refinement

ALBEDO_TOLERANCE = 1e-3  # beyond [0, 1]: half floats and antialiasing
CEILING_TOLERANCE = 1e-3  # above a ceiling, relative to it
NEIGHBOUR_TOLERANCE = 1e-3  # mean difference between batch sizes: kernels sum in another order
ODD = (37, 31)  # neither square nor even


def check_prior(make: Callable[[], Any], stack: Stack) -> Iterator[Finding]:
    """Check the prior that ``make()`` returns (called several times, so that instances can be compared).

    ``stack`` holds at least three views. Later rules need the earlier ones: where the members or the plain sample fail,
    the list ends with a line that says so. Never raises for what the prior does.
    """
    with process_state_kept():
        torch.use_deterministic_algorithms(not torch.cuda.is_available())  # as a run asks for where nothing is on CUDA
        try:
            prior = make()
            members = list(check_members(prior))
        except (Exception, SystemExit) as error:
            yield Finding("fail", "construction", "an object", raised(error))
            return
        yield from members
        if any(finding.status == "fail" for finding in members):
            yield Finding("skip", "everything else", "", "it needs the members above")
            return
        subject = Subject(make, prior, stack)
        for title, rule in RULES:
            try:
                findings = list(rule(subject))
            except (Exception, SystemExit) as error:
                findings = [Finding("fail", title, "no exception", raised(error))]
            yield from findings
            if rule is _plain_sample and any(finding.status == "fail" for finding in findings):
                yield Finding("skip", "everything else", "", "it needs a sound sample")
                return
            if rule is _plain_sample and not prior.info.provides:
                yield Finding("skip", "everything else", "", "the prior provides nothing, so there is nothing to check")
                return


# ---- one sample ------------------------------------------------------------------------------------------------------


def _plain_sample(subject: Subject) -> Iterator[Finding]:
    yield from _sound(subject, subject.base, subject.stack)


def _sound(subject: Subject, samples: Samples, stack: Stack) -> Iterator[Finding]:
    """Whether ``samples`` may pass the border that they meet in a run, and hold what images can hold."""
    expected = f"{', '.join(subject.components) or 'nothing'}: finite float32 tensors on the CPU, without gradient"
    try:
        checked(type(subject.prior).__qualname__, "sample", samples, subject.info.provides, tuple(stack.images.shape))
    except InputError as error:
        yield Finding("fail", "samples", expected, str(error))
        return
    yield Finding("pass", "samples", expected, "as expected")
    outside = stack.masks == 0
    for name, sample in sorted(samples.values.items()):
        low, high = float(sample.min()), float(sample.max())
        found = f"{low:.4g} ... {high:.4g}"
        if name == "albedo":
            within = low >= -ALBEDO_TOLERANCE and high <= 1 + ALBEDO_TOLERANCE
            yield judge(within, f"{name}: range", f"within [0, 1] up to {ALBEDO_TOLERANCE:g}", found)
        else:
            yield judge(low >= 0, f"{name}: range", "radiance >= 0", found)
        most = float(sample[outside].abs().max()) if bool(outside.any()) else 0.0
        yield judge(most <= 1e-6, f"{name}: premultiplied", "zero where the mask is", f"at most {most:.3g} outside")
        if name in samples.ceilings:
            share = float((sample.amax((1, 2, 3)) / samples.ceilings[name]).max())
            yield judge(share <= 1 + CEILING_TOLERANCE, f"{name}: ceiling", "no value above it", f"at most {share:.4g} of it")


def _judge_sound(subject: Subject, what: str, expected: str, samples: Samples, stack: Stack) -> Finding:
    """One finding of everything that :func:`_sound` asks."""
    wrong = [finding for finding in _sound(subject, samples, stack) if finding.status == "fail"]
    return judge(not wrong, what, expected, "; ".join(f"{finding.what}: {finding.found}" for finding in wrong) or "sound")


def _other_images(subject: Subject) -> Iterator[Finding]:
    others = {
        f"{ODD[0]} x {ODD[1]} images": painted_ball(*ODD, len(subject.stack.views)),
        "all-black images": subject.stack.black(),
        "a view with an empty mask": subject.stack.with_empty_view(),
    }
    for what, stack in others.items():
        yield _judge_sound(subject, what, "a sound sample (what a run accepts, range, premultiplied)", subject.ask(stack), stack)


# ---- repeatability ---------------------------------------------------------------------------------------------------


def _repeatable(subject: Subject) -> Iterator[Finding]:
    base, other = subject.base, subject.ask(subject.stack, seed=1)
    largest = {name: _largest(base.values[name], other.values[name]) for name in subject.components}
    text = ", ".join(f"{name} differs by at most {value:.3g}" for name, value in largest.items())
    stochastic, differs = subject.info.stochastic, any(value > 0 for value in largest.values())
    expected = f"{'another' if stochastic else 'the same'} sample, because stochastic = {stochastic}"
    yield judge(differs == stochastic, "another seed", expected, text)
    for what, prior in (("same seed again", subject.prior), ("same seed, new instance", subject.make())):
        again = subject.ask(subject.stack, prior=prior)
        yield _same(what, base, again)


def _independent(subject: Subject) -> Iterator[Finding]:
    what = "an image on its own"
    if subject.info.sees_truth:
        yield Finding("skip", what, "", "a prior that sees truth is asked about a scene, and may draw for all of its views")
        return
    alone = [subject.ask(subject.stack.one(view)) for view in range(len(subject.stack.views))]
    yield _beside_others(what, {name: torch.cat([one.values[name] for one in alone]) for name in subject.components}, subject.base)


def _beside_others(what: str, alone: Mapping[str, Tensor], together: Samples) -> Finding:
    difference = max(float((alone[name] - together.values[name][: len(alone[name])]).abs().mean()) for name in alone)
    expected = f"what it is beside others, up to {NEIGHBOUR_TOLERANCE:g} in the mean"
    return judge(difference <= NEIGHBOUR_TOLERANCE, what, expected, f"a mean difference of {difference:.3g}")


# ---- guidance --------------------------------------------------------------------------------------------------------


def _guided(subject: Subject) -> Iterator[Finding]:
    if not subject.info.guidable:
        yield Finding("skip", "guidance", "", "the prior is not guidable, so it is never given any")
        return
    stack, base = subject.stack, subject.base
    render = _fitted(stack, subject.components)
    guided = subject.ask(stack, guidance={name: value.clone() for name, value in render.items()})
    for name in subject.components:
        before, after = (float((samples.values[name] - render[name]).abs().mean()) for samples in (base, guided))
        if subject.info.stochastic:
            nearer, expected = after < before, "nearer to the render"
        else:  # nothing but one sample to choose from
            nearer, expected = after <= before, "no farther from the render"
        yield judge(nearer, f"guided {name}", expected, f"mean distance {before:.4g} unguided, {after:.4g} guided")
    yield _judge_sound(subject, "guided sample", "sound like the unguided one", guided, stack)
    yield _same("guidance = None afterwards", base, subject.ask(stack))
    if not hasattr(subject.prior, "guidance_strength"):
        yield Finding("skip", "guidance of strength 0", "", "the prior has no guidance_strength")
        return
    weak: Any = subject.make()
    weak.guidance_strength = 0.0
    yield _same("guidance of strength 0", base, subject.ask(stack, guidance=render, prior=weak))


# ---- what a prior may offer besides ----------------------------------------------------------------------------------


def _distilled(subject: Subject) -> Iterator[Finding]:
    if not hasattr(subject.prior, "distill"):
        return
    stack = subject.stack
    renders = _fitted(stack, subject.components)
    estimates = subject.distill(stack, {name: render.clone() for name, render in renders.items()}, 0)
    finding = _judge_sound(subject, "distilled estimates", "sound like samples", estimates, stack)
    yield finding
    if finding.status == "pass":
        yield _same("distilled again", estimates, subject.distill(stack, renders, 0))


def _refined(subject: Subject) -> Iterator[Finding]:
    if not hasattr(subject.prior, "refine"):
        return
    stack = subject.stack
    corrected = subject.refine(stack, _finished(stack))
    what, expected = "a corrected fit", "a finite albedo, and roughness if any, zero where the mask is"
    try:
        checked_refinement(type(subject.prior).__qualname__, corrected, tuple(stack.images.shape))
    except InputError as error:
        yield Finding("fail", what, expected, str(error))
        return
    outside = max(float(maps[stack.masks == 0].abs().max()) for maps in corrected.values.values())
    yield judge(outside <= 1e-6, what, expected, f"at most {outside:.3g} outside")
    yield _same("corrected again", corrected, subject.refine(stack, _finished(stack)))
    alone = subject.refine(stack.one(0), {name: render[:1].clone() for name, render in _finished(stack).items()})
    yield _beside_others("one corrected on its own", alone.values, corrected)
    subject.refine(stack.with_empty_view(), _finished(stack.with_empty_view()))


def _fitted(stack: Stack, components: Sequence[str] = COMPONENTS) -> Images:
    """What a fit might render of a stack, which is no sample: the truth, darker and flatter."""
    return {name: 0.7 * stack.truth(name) + 0.1 * stack.masks[..., None] for name in components}


def _finished(stack: Stack) -> Images:
    """What a finished fit might show in a stack, of which nothing else is known: half rough, a little off, matt."""
    masks = stack.masks[..., None]
    more = {"radiance": 0.9 * stack.images, "roughness": 0.5 * masks, "evidence": 0.1 * masks.expand(-1, -1, -1, 2)}
    return _fitted(stack) | more


def _with_geometry(subject: Subject) -> Iterator[Finding]:
    if subject.info.wants.isdisjoint(GEOMETRY):
        return
    stack = subject.stack
    subject.geometry = True
    samples = subject.ask(stack)
    yield _judge_sound(subject, "a sample with geometry", "sound like one without", samples, stack)
    subject.ask(stack.one(1))  # which brings other geometry
    yield _same("the same geometry again", samples, subject.ask(stack))
    subject.geometry = False


# ---- wrong input -----------------------------------------------------------------------------------------------------


def _refuses(subject: Subject) -> Iterator[Finding]:
    shown = subject.shown(subject.stack)
    spoiled = shown.images.clone()
    spoiled[0, spoiled.shape[1] // 2, spoiled.shape[2] // 2] = torch.nan
    mistakes = {
        "a NaN pixel": replace(shown, images=spoiled),
        "images of one channel": replace(shown, images=shown.images[..., :1].clone()),
        "masks of another size": replace(shown, masks=shown.masks[:, 1:].clone()),
    }
    for what, wrong in mistakes.items():
        expected, clear, found = "a ValueError or TypeError that says what is wrong", False, "a sample"
        try:
            subject.ask_about(wrong)
        except Exception as error:
            clear, found = isinstance(error, ValueError | TypeError) and bool(str(error)), raised(error)
        yield judge(clear, what, expected, found)


def _untouched(subject: Subject) -> Iterator[Finding]:
    found = ", ".join(sorted(subject.modified)) or "nothing"
    yield judge(not subject.modified, "inputs", "nothing modified", f"{found} modified")


def _counted(subject: Subject) -> Iterator[Finding]:
    if subject.forwards:
        calls = sum(cost.get("network_calls", 0) for cost in subject.costs)
        yield judge(calls > 0, "cost: network_calls", "some, because the prior asks a network", f"{calls} in all samples")


RULES: tuple[tuple[str, Callable[[Subject], Iterator[Finding]]], ...] = (
    ("a sample", _plain_sample),
    ("other images", _other_images),
    ("seeds", _repeatable),
    ("an image on its own", _independent),
    ("guidance", _guided),
    ("distillation", _distilled),
    ("refinement", _refined),
    ("wrong input", _refuses),
    ("inputs", _untouched),
    ("cost: network_calls", _counted),
    ("geometry", _with_geometry),
)
"""Every rule after the declared members, in order; the first name stands for the rule where it raises."""


def _same(what: str, base: Samples, again: Samples) -> Finding:
    largest = max(_largest(value, again.values[name]) for name, value in base.values.items())
    found = "the same" if largest == 0 else f"a difference of up to {largest:.3g}"
    return judge(largest == 0, what, "the same sample to the bit", found)


def _largest(a: Tensor, b: Tensor) -> float:
    return float((a - b).abs().max())
