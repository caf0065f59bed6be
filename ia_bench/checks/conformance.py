"""Does a prior keep the contract of :mod:`ia_bench.priors.contract`? One finding per question, with what was found.

A prior is judged by what it does: every rule samples it on small posed images, under the settings of a run. A prior
with ``sees_truth`` is first revealed the views it is asked about, since it knows no others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ia_bench.checks.finding import Finding, judge, raised
from ia_bench.checks.members import check_members, is_int
from ia_bench.checks.stack import Stack, painted_ball
from ia_bench.priors.contract import Prior

ALBEDO_TOLERANCE = 1e-3  # beyond [0, 1]: half floats and antialiasing
NEIGHBOUR_TOLERANCE = 1e-3  # mean difference between batch sizes: kernels sum in another order
ODD = (37, 31)  # neither square nor even

Samples = dict[str, Tensor]


def check_prior(make: Callable[[], Any], stack: Stack) -> Iterator[Finding]:
    """Check the prior that ``make()`` returns (called several times, so that instances can be compared).

    ``stack`` holds at least three views. Later rules need the earlier ones: where the members or the plain sample fail,
    the list ends with a line that says so. Never raises for what the prior does.
    """
    with _as_in_a_run():
        try:
            prior = make()
        except Exception as error:
            yield Finding("fail", "construction", "an object", raised(error))
            return
        members = list(check_members(prior))
        yield from members
        if any(finding.status == "fail" for finding in members):
            yield Finding("skip", "everything else", "", "it needs the members above")
            return
        subject = _Subject(make, prior, stack)
        for title, rule in RULES:
            try:
                findings = list(rule(subject))
            except Exception as error:
                findings = [Finding("fail", title, "no exception", raised(error))]
            yield from findings
            if rule is _plain_sample and any(finding.status == "fail" for finding in findings):
                yield Finding("skip", "everything else", "", "it needs a sound sample")
                return
            if rule is _plain_sample and not prior.provides:
                yield Finding("skip", "everything else", "", "the prior provides nothing, so there is nothing to check")
                return


class _Subject:
    """The prior under test, and how to ask it: copies of the inputs, other global random states, counted calls."""

    def __init__(self, make: Callable[[], Prior], prior: Prior, stack: Stack) -> None:
        self.make, self.prior, self.stack = make, prior, stack
        self.calls_before = prior.network_calls
        self.components = sorted(prior.provides)
        self.modified: set[str] = set()
        self.geometry = False  # whether a prior that reads geometry is given it
        self._asked = 0
        self._base: Samples | None = None

    def ask(
        self, stack: Stack, *, seed: int = 0, guidance: Samples | None = None, prior: Prior | None = None
    ) -> Samples:
        """One sample of the prior under test, or of another instance of it."""
        prior = self.prior if prior is None else prior
        self.prepare(prior, stack)
        return self.ask_tensors(prior, stack.images, stack.masks, seed, guidance)

    def prepare(self, prior: Prior, stack: Stack) -> None:
        """Show the prior what a run would show it of the views before asking about them."""
        if prior.sees_truth:
            prior.reveal(stack.views)  # type: ignore[attr-defined]  # its members were checked first
        if self.geometry and getattr(prior, "reads_geometry", False):
            prior.give_geometry(*stack.geometry())  # type: ignore[attr-defined]

    def distill(self, stack: Stack, renders: Samples, seed: int) -> Samples:
        """Estimates of ``renders`` by the prior under test."""
        self.prepare(self.prior, stack)
        inputs = {"images": stack.images, "masks": stack.masks, **{f"renders {k}": v for k, v in renders.items()}}
        return self._watched(inputs, lambda: self.prior.distill(inputs["images"], inputs["masks"], renders, seed=seed))  # type: ignore[attr-defined]

    def ask_tensors(self, prior: Prior, images: Tensor, masks: Tensor, seed: int, guidance: Samples | None) -> Samples:
        """The same for tensors that are no stack, without revealing anything."""
        inputs = {"images": images, "masks": masks, **{f"guidance {k}": v for k, v in (guidance or {}).items()}}
        return self._watched(inputs, lambda: prior.sample(images, masks, seed=seed, guidance=guidance))

    def _watched(self, inputs: Samples, call: Callable[[], Samples]) -> Samples:
        """What ``call`` returns; remembers which of its inputs it wrote to."""
        kept = {name: value.clone() for name, value in inputs.items()}
        self._asked += 1  # another state of the global generators each time: a sample must not depend on them
        torch.manual_seed(self._asked)
        np.random.seed(self._asked)
        samples = call()
        self.modified |= {n for n, v in inputs.items() if not torch.equal(v.nan_to_num(), kept[n].nan_to_num())}
        return samples

    @property
    def base(self) -> Samples:
        """The unguided sample of the stack for seed 0."""
        if self._base is None:
            samples = self.ask(self.stack)  # cloned, because the prior may write to what it has handed out
            self._base = {name: s.clone() if isinstance(s, Tensor) else s for name, s in samples.items()}
        return self._base


# ---- one sample ------------------------------------------------------------------------------------------------------


def _plain_sample(subject: _Subject) -> Iterator[Finding]:
    samples = subject.base
    expected = ", ".join(subject.components) or "nothing"
    yield judge(sorted(samples) == subject.components, "components", expected, ", ".join(sorted(samples)) or "nothing")
    for name in (name for name in subject.components if name in samples):
        yield from _sound(name, samples[name], subject.stack)


def _sound(name: str, sample: Any, stack: Stack) -> Iterator[Finding]:  # noqa: ANN401 (whatever the prior returned)
    shape = tuple(stack.images.shape)
    if not isinstance(sample, Tensor) or tuple(sample.shape) != shape:
        found = f"shape {tuple(sample.shape)}" if isinstance(sample, Tensor) else type(sample).__name__
        yield Finding("fail", f"{name}: shape", f"a tensor of shape {shape}", found)
        return
    yield Finding("pass", f"{name}: shape", f"a tensor of shape {shape}", f"shape {shape}")
    kind = f"{sample.dtype}{', with gradient' if sample.requires_grad else ''}"
    yield judge(kind == "torch.float32", f"{name}: type", "torch.float32 without gradient", kind)
    sample = sample.detach()
    bad = int((~torch.isfinite(sample)).sum())
    yield judge(bad == 0, f"{name}: finite", "no NaN or Inf", f"{bad} of {sample.numel()} values")
    low, high = float(sample.min()), float(sample.max())
    found = f"{low:.4g} ... {high:.4g}"
    if name == "albedo":
        within = low >= -ALBEDO_TOLERANCE and high <= 1 + ALBEDO_TOLERANCE
        yield judge(within, f"{name}: range", f"within [0, 1] up to {ALBEDO_TOLERANCE:g}", found)
    else:
        yield judge(low >= 0, f"{name}: range", "radiance >= 0", found)
    outside = stack.masks == 0
    most = float(sample[outside].abs().max()) if bool(outside.any()) else 0.0
    yield judge(most <= 1e-6, f"{name}: premultiplied", "zero where the mask is", f"at most {most:.3g} outside")


def _other_images(subject: _Subject) -> Iterator[Finding]:
    ball = painted_ball(*ODD, len(subject.stack.views))
    for what, stack in (
        (f"{ODD[0]} x {ODD[1]} images", ball),
        ("all-black images", subject.stack.black()),
        ("a view with an empty mask", subject.stack.with_empty_view()),
    ):
        samples = subject.ask(stack)
        wrong = [f for name in subject.components for f in _sound(name, samples[name], stack) if f.status == "fail"]
        found = "; ".join(f"{finding.what}: {finding.found}" for finding in wrong) or "sound"
        yield judge(not wrong, what, "a sound sample (shape, type, finite, range, premultiplied)", found)


# ---- repeatability ---------------------------------------------------------------------------------------------------


def _repeatable(subject: _Subject) -> Iterator[Finding]:
    base, other = subject.base, subject.ask(subject.stack, seed=1)
    largest = {name: _largest(base[name], other[name]) for name in subject.components}
    text = ", ".join(f"{name} differs by at most {value:.3g}" for name, value in largest.items())
    stochastic, differs = subject.prior.stochastic, any(value > 0 for value in largest.values())
    expected = f"{'another' if stochastic else 'the same'} sample, because stochastic = {stochastic}"
    yield judge(differs == stochastic, "another seed", expected, text)
    for what, prior in (("same seed again", subject.prior), ("same seed, new instance", subject.make())):
        again = subject.ask(subject.stack, prior=prior)
        yield _same(what, base, again)


def _independent(subject: _Subject) -> Iterator[Finding]:
    what = "an image on its own"
    if subject.prior.sees_truth:
        yield Finding("skip", what, "", "a prior that sees truth is bound to the views it was revealed")
        return
    together = subject.base
    alone = [subject.ask(subject.stack.one(view)) for view in range(len(subject.stack.views))]
    difference = max(
        float((torch.cat([one[name] for one in alone]) - together[name]).abs().mean()) for name in subject.components
    )
    expected = f"its sample in a batch of {len(alone)}, up to {NEIGHBOUR_TOLERANCE:g} in the mean"
    yield judge(difference <= NEIGHBOUR_TOLERANCE, what, expected, f"a mean difference of {difference:.3g}")


# ---- guidance --------------------------------------------------------------------------------------------------------


def _guided(subject: _Subject) -> Iterator[Finding]:
    if not subject.prior.guidable:
        yield Finding("skip", "guidance", "", "the prior is not guidable, so it is never given any")
        return
    stack, base = subject.stack, subject.base
    # A plausible render that is not the sample: the truth, darker and flatter.
    render = {name: 0.7 * stack.truth(name) + 0.1 * stack.masks[..., None] for name in subject.components}
    guided = subject.ask(stack, guidance={name: value.clone() for name, value in render.items()})
    for name in subject.components:
        before, after = (float((samples[name] - render[name]).abs().mean()) for samples in (base, guided))
        if subject.prior.stochastic:
            nearer, expected = after < before, "nearer to the render"
        else:  # nothing but one sample to choose from
            nearer, expected = after <= before, "no farther from the render"
        yield judge(nearer, f"guided {name}", expected, f"mean distance {before:.4g} unguided, {after:.4g} guided")
    broken = [f for name in subject.components for f in _sound(name, guided[name], stack) if f.status == "fail"]
    found = "; ".join(f"{finding.what}: {finding.found}" for finding in broken) or "sound"
    yield judge(not broken, "guided sample", "sound like the unguided one", found)
    yield _same("guidance = None afterwards", base, subject.ask(stack))
    if not hasattr(subject.prior, "guidance_strength"):
        yield Finding("skip", "guidance of strength 0", "", "the prior has no guidance_strength")
        return
    weak: Any = subject.make()
    weak.guidance_strength = 0.0
    yield _same("guidance of strength 0", base, subject.ask(stack, guidance=render, prior=weak))


# ---- what a prior may offer besides ----------------------------------------------------------------------------------


def _distilled(subject: _Subject) -> Iterator[Finding]:
    if not hasattr(subject.prior, "distill"):
        return
    stack = subject.stack
    renders = {name: 0.7 * stack.truth(name) + 0.1 * stack.masks[..., None] for name in subject.components}
    estimates = subject.distill(stack, renders, 0)
    expected = ", ".join(subject.components)
    found = ", ".join(sorted(estimates))
    yield judge(found == expected, "distilled components", expected, found or "nothing")
    broken = [
        f for n in subject.components if n in estimates for f in _sound(n, estimates[n], stack) if f.status == "fail"
    ]
    found = "; ".join(f"{finding.what}: {finding.found}" for finding in broken) or "sound"
    yield judge(not broken, "distilled estimates", "sound like samples", found)
    if found == "sound" and sorted(estimates) == subject.components:
        yield _same("distilled again", estimates, subject.distill(stack, renders, 0))


def _with_geometry(subject: _Subject) -> Iterator[Finding]:
    if not getattr(subject.prior, "reads_geometry", False):
        return
    stack = subject.stack
    subject.geometry = True
    samples = {name: sample.clone() for name, sample in subject.ask(stack).items()}
    broken = [f for n in subject.components for f in _sound(n, samples[n], stack) if f.status == "fail"]
    found = "; ".join(f"{finding.what}: {finding.found}" for finding in broken) or "sound"
    yield judge(not broken, "a sample with geometry", "sound like one without", found)
    subject.ask(stack.one(1))  # which brings other geometry
    yield _same("the same geometry again", samples, subject.ask(stack))
    subject.geometry = False


# ---- wrong input -----------------------------------------------------------------------------------------------------


def _refuses(subject: _Subject) -> Iterator[Finding]:
    spoiled = subject.stack.images
    spoiled[0, spoiled.shape[1] // 2, spoiled.shape[2] // 2] = torch.nan
    images, masks = subject.stack.images, subject.stack.masks
    subject.ask(subject.stack)  # whoever sees truth knows these views
    for what, wrong_images, wrong_masks in (
        ("a NaN pixel", spoiled, masks),
        ("images of one channel", images[..., :1].clone(), masks),
        ("masks of another size", images, masks[:, 1:].clone()),
    ):
        try:
            subject.ask_tensors(subject.prior, wrong_images, wrong_masks, 0, None)
        except Exception as error:
            clear = isinstance(error, ValueError | TypeError) and bool(str(error))
            yield judge(clear, what, "a ValueError or TypeError that says what is wrong", raised(error))
        else:
            yield Finding("fail", what, "a ValueError or TypeError that says what is wrong", "a sample")


def _untouched(subject: _Subject) -> Iterator[Finding]:
    found = ", ".join(sorted(subject.modified)) or "nothing"
    yield judge(not subject.modified, "inputs", "nothing modified", f"{found} modified")


def _counted(subject: _Subject) -> Iterator[Finding]:
    before, after = subject.calls_before, subject.prior.network_calls
    network = any(isinstance(value, torch.nn.Module) for value in (subject.prior, *vars(subject.prior).values()))
    expected = "to grow, because the prior holds a network" if network else "not to fall"
    grown = after > before if network else after >= before
    yield judge(is_int(after) and grown, "network_calls over all samples", expected, f"{before} -> {after}")


RULES: tuple[tuple[str, Callable[[_Subject], Iterator[Finding]]], ...] = (
    ("a sample", _plain_sample),
    ("other images", _other_images),
    ("seeds", _repeatable),
    ("an image on its own", _independent),
    ("guidance", _guided),
    ("distillation", _distilled),
    ("wrong input", _refuses),
    ("inputs", _untouched),
    ("network_calls over all samples", _counted),
    ("geometry", _with_geometry),
)
"""Every rule after the declared members, in order; the first name stands for the rule where it raises."""


# ---- helpers ---------------------------------------------------------------------------------------------------------


def _same(what: str, base: Samples, again: Samples) -> Finding:
    largest = max(_largest(base[name], again[name]) for name in base)
    found = "the same" if largest == 0 else f"a difference of up to {largest:.3g}"
    return judge(largest == 0, what, "the same sample to the bit", found)


def _largest(a: Tensor, b: Tensor) -> float:
    return float((a - b).abs().max())


@contextmanager
def _as_in_a_run() -> Iterator[None]:
    """Deterministic algorithms only, as run.py asks for; global random states are put back afterwards."""
    deterministic = torch.are_deterministic_algorithms_enabled()
    state, numpy_state = torch.get_rng_state(), np.random.get_state()
    torch.use_deterministic_algorithms(True)
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(deterministic)
        torch.set_rng_state(state)
        np.random.set_state(numpy_state)
