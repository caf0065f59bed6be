"""Does a prior keep the contract of :mod:`ia_bench.priors.contract`? One finding per question, with what was found.

A prior is judged by what it does: every rule samples it on small images, under the settings of a run. A prior that wants truth
is shown it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import torch
from torch import Tensor
from torch.nn.modules.module import register_module_forward_pre_hook

from ia_bench.checks.finding import Finding, guarded, judge, other_chance, told
from ia_bench.checks.painted_ball import painted_ball, shown
from ia_bench.common.errors import InputError
from ia_bench.common.registry import process_state_kept
from ia_bench.methods.couplings.base import coupling_of
from ia_bench.methods.info import AUTO
from ia_bench.priors.contract import COMPONENTS, Distiller, Observations, Prior, Refiner, Samples
from ia_bench.priors.validation import check_prior_info, checked, fingerprint_of

ALBEDO_TOLERANCE = 1e-3  # beyond [0, 1]: half floats and antialiasing
CEILING_TOLERANCE = 1e-3  # above a ceiling, relative to it
NEIGHBOUR_TOLERANCE = 1e-3  # mean difference between batch sizes: kernels sum in another order
ODD = (37, 31)  # neither square nor even
GEOMETRY = frozenset({"normals", "visibility", "view_count"})
"""What a prior may want of a scene, and must do without."""

Images = Mapping[str, Tensor]


def check_prior(make: Callable[[], Any], known: Observations) -> Iterator[Finding]:
    """Check the prior that ``make()`` returns (called several times, so that instances can be compared).

    ``known``: at least three images, with their truth and geometry. Later rules need the earlier ones: where the members or
    the plain sample fail, the list ends with a line that says so. Never raises for what the prior does.
    """
    with process_state_kept():
        torch.use_deterministic_algorithms(not torch.cuda.is_available())  # as a run asks for where nothing is on CUDA
        try:
            prior = make()
            check_prior_info(prior)
            subject = Subject(make, prior, known)
        except (Exception, SystemExit) as error:
            yield Finding("fail", "construction", "a prior with info and sample()", told(error))
            return
        sets = {name: sorted(value) if isinstance(value, frozenset) else value for name, value in vars(prior.info).items()}
        yield Finding("pass", "info", "", ", ".join(f"{name} {value}" for name, value in sets.items()))
        for title, rule in RULES.items():
            findings = list(guarded(title, "no exception", partial(rule, subject)))
            yield from findings
            failed = any(finding.status == "fail" for finding in findings)
            if title == "a sample" and (failed or not subject.components):
                yield Finding("skip", "everything else", "", "it needs a sound sample" if failed else "the prior provides nothing")
                return


class Subject:
    """The prior under test, and how to ask it: copies of the inputs, other global random states, what it cost."""

    def __init__(self, make: Callable[[], Any], prior: Any, known: Observations) -> None:  # noqa: ANN401 (may be more than a Prior)
        self.make, self.prior, self.known = make, prior, known
        self.info, self.components = prior.info, sorted(prior.info.provides)
        self.modified: set[str] = set()
        self.network_calls = self.forwards = self._asked = 0  # as it counts them, as they are, and how often it was asked

    def ask(self, known: Observations, *, prior: Prior | None = None, seed: int = 0, guidance: Images | None = None) -> Samples:
        """One sample of the prior under test, or of another instance of it, which is shown no geometry."""
        return self.watched((prior or self.prior).sample, known, GEOMETRY, guidance=guidance, seed=seed)

    def watched(self, call: Callable[..., Samples], known: Observations, hidden: frozenset[str], **given: Any) -> Samples:  # noqa: ANN401
        """What ``call`` returns, shown all that the prior wants but what is ``hidden``.

        Remembers which of its inputs the call wrote to, and what it cost.
        """
        seen = shown(known, self.info.wants - hidden)
        tables = {"true": seen.truth, **{what: value for what, value in given.items() if isinstance(value, Mapping)}}
        given |= {what: dict(value) for what, value in given.items() if isinstance(value, Mapping)}
        inputs = {name: value for name, value in vars(seen).items() if isinstance(value, Tensor)}
        inputs |= {f"{what} {name}": value for what, table in tables.items() for name, value in (table or {}).items()}
        kept = {name: value.clone() for name, value in inputs.items()}
        self._asked += 1

        def count(module: torch.nn.Module, _: object) -> None:  # one without weights, such as of pooling, is no network
            self.forwards += any(True for _ in module.parameters())

        counted = register_module_forward_pre_hook(count)
        with counted, other_chance(self._asked):
            samples = call(seen, **given)
        if isinstance(samples, Samples) and all(isinstance(part, Mapping) for part in vars(samples).values()):
            calls = samples.cost.get("network_calls", 0)
            self.network_calls += calls if isinstance(calls, int) else 0  # anything else is no sound sample
            copies = {name: value.clone() if isinstance(value, Tensor) else value for name, value in samples.values.items()}
            samples = replace(samples, values=copies)  # what it has handed out may be written to: by it, or as its inputs below
        self.modified |= {n for n, v in inputs.items() if not torch.equal(v.nan_to_num(), kept[n].nan_to_num())}
        for name, value in kept.items():  # so that one wrong write fails no later rule
            inputs[name].copy_(value)
        return samples

    @cached_property
    def base(self) -> Samples:
        """The unguided sample for seed 0."""
        return self.ask(self.known)


# ---- one sample ------------------------------------------------------------------------------------------------------


def _sound(subject: Subject, samples: Samples, known: Observations, method: str = "sample") -> Iterator[Finding]:
    """Whether ``samples``, which a ``method`` gave, may pass the border that they meet in a run, and hold what images can."""
    expected = f"{', '.join(subject.components) or 'nothing'}: finite float32 tensors on the CPU, without gradient"
    try:
        checked(type(subject.prior).__qualname__, method, samples, subject.info.provides, tuple(known.images.shape))
    except InputError as error:
        yield Finding("fail", "samples", expected, str(error))
        return
    yield Finding("pass", "samples", expected, "")
    outside = known.masks == 0
    for name, sample in sorted(samples.values.items()):
        low, high = float(sample.min()), float(sample.max())
        within = low >= -ALBEDO_TOLERANCE and high <= 1 + ALBEDO_TOLERANCE if name == "albedo" else low >= 0
        expected = f"within [0, 1] up to {ALBEDO_TOLERANCE:g}" if name == "albedo" else "radiance >= 0"
        yield judge(within, f"{name}: range", expected, f"{low:.4g} ... {high:.4g}")
        most = float(sample[outside].abs().max()) if bool(outside.any()) else 0.0
        yield judge(most <= 1e-6, f"{name}: premultiplied", "zero where the mask is", f"at most {most:.3g} outside")
        if name in samples.ceilings:
            share = float((sample.amax((1, 2, 3)) / samples.ceilings[name]).max())
            yield judge(share <= 1 + CEILING_TOLERANCE, f"{name}: ceiling", "no value above it", f"at most {share:.4g} of it")


def _judge_sound(subject: Subject, what: str, samples: Samples, known: Observations, method: str = "sample") -> Finding:
    """One finding of everything that :func:`_sound` asks."""
    wrong = [f"{one.what}: {one.found}" for one in _sound(subject, samples, known, method) if one.status == "fail"]
    return judge(not wrong, what, "what a run accepts, in range, zero where the mask is", "; ".join(wrong))


def _other_images(subject: Subject) -> Iterator[Finding]:
    known = subject.known
    others = {
        f"{ODD[0]} x {ODD[1]} images": painted_ball(*ODD, len(known.images)),
        "all-black images": replace(known, images=0 * known.images, truth={**(known.truth or {}), "specular": 0 * known.images}),
        "a view with an empty mask": _with_empty_view(known),
    }
    for what, other in others.items():
        yield _judge_sound(subject, what, subject.ask(other), other)


def _with_empty_view(known: Observations) -> Observations:
    """The first view sees nothing: its mask and all its pictures are zero."""
    return known.each(lambda tensor: torch.cat([0 * tensor[:1], tensor[1:]]))


def _recommended(subject: Subject) -> Iterator[Finding]:
    """Whether a run finds the coupling that the info recommends, and can use the prior by it."""
    info = subject.info
    if info.coupling is None:
        return
    expected = "one that a run finds; of one that asks again while it fits, a method distill"
    try:
        coupling = coupling_of(info, AUTO, None, {}, lambda _: None)
    except InputError as error:
        yield Finding("fail", "coupling", expected, str(error))
        return
    lacking = bool(coupling.period) and not isinstance(subject.prior, Distiller)
    yield judge(not lacking, "coupling", expected, f"{info.coupling}{', and no distill' * lacking}")


# ---- repeatability ---------------------------------------------------------------------------------------------------


def _repeatable(subject: Subject) -> Iterator[Finding]:
    base, stochastic = subject.base, subject.info.stochastic
    largest = _difference(base, subject.ask(subject.known, seed=1))
    expected = f"{'another' if stochastic else 'the same'} sample, because stochastic = {stochastic}"
    yield judge(largest > 0 if stochastic else largest == 0, "another seed", expected, f"a difference of up to {largest:.3g}")
    yield _same("same seed again", base, subject.ask(subject.known))
    yield _same("same seed, new instance", base, subject.ask(subject.known, prior=subject.make()))


def _independent(subject: Subject) -> Iterator[Finding]:
    what = "an image on its own"
    if subject.info.sees_truth:
        yield Finding("skip", what, "", "a prior that sees truth is asked about a scene, and may draw for all of its views")
        return
    alone = [subject.ask(subject.known.select([view])) for view in range(len(subject.known.images))]
    yield _beside_others(what, {name: torch.cat([one.values[name] for one in alone]) for name in subject.components}, subject.base)


def _beside_others(what: str, alone: Images, together: Samples) -> Finding:
    difference = _largest((alone[name] - together.values[name][: len(alone[name])]).abs().mean() for name in alone)
    expected = f"what it is beside others, up to {NEIGHBOUR_TOLERANCE:g} in the mean"
    return judge(difference <= NEIGHBOUR_TOLERANCE, what, expected, f"a mean difference of {difference:.3g}")


def _same(what: str, base: Samples, again: Samples) -> Finding:
    largest = _difference(base, again)
    return judge(largest == 0, what, "the same sample to the bit", f"a difference of up to {largest:.3g}" if largest else "")


def _difference(base: Samples, again: Samples) -> float:
    return _largest((value - again.values[name]).abs().max() for name, value in base.values.items())


def _largest(values: Iterable[Tensor]) -> float:
    """The largest of some numbers, NaN if any is: Python's own ``max`` may overlook one."""
    return float(torch.stack(list(values)).max())


# ---- guidance, and what a prior may offer besides ----------------------------------------------------------------------


def _fitted(known: Observations, names: Iterable[str] = COMPONENTS) -> dict[str, Tensor]:
    """What a fit might render, which is no sample: the truth, darker and flatter."""
    return {name: 0.7 * true + 0.1 * known.masks[..., None] for name, true in (known.truth or {}).items() if name in names}


def _guided(subject: Subject) -> Iterator[Finding]:
    if not subject.info.guidable:
        yield Finding("skip", "guidance", "", "the prior is not guidable, so it is never given any")
        return
    known, base = subject.known, subject.base
    render = _fitted(known, subject.components)
    guided = subject.ask(known, guidance=render)
    for name in subject.components:
        before, after = (float((samples.values[name] - render[name]).abs().mean()) for samples in (base, guided))
        nearer = after < before or (after == before and not subject.info.stochastic)  # which has but one sample to choose from
        found = f"mean distance {before:.4g} unguided, {after:.4g} guided"
        yield judge(nearer, f"guided {name}", "nearer to the render, or as near if not stochastic", found)
    yield _judge_sound(subject, "guided sample", guided, known)
    yield _same("guidance = None afterwards", base, subject.ask(known))
    if not hasattr(subject.prior, "guidance_strength"):
        yield Finding("skip", "guidance of strength 0", "", "the prior has no guidance_strength")
        return
    weak = subject.make()
    weak.guidance_strength = 0.0
    yield _same("guidance of strength 0", base, subject.ask(known, guidance=render, prior=weak))


def _distilled(subject: Subject) -> Iterator[Finding]:
    if not isinstance(subject.prior, Distiller):
        return
    given = {"renders": _fitted(subject.known, subject.components), "seed": 0}
    distilled = partial(subject.watched, subject.prior.distill, subject.known, GEOMETRY, **given)
    finding = _judge_sound(subject, "distilled estimates", estimates := distilled(), subject.known, "distill")
    yield finding
    if finding.status == "pass":
        yield _same("distilled again", estimates, distilled())


def _refined(subject: Subject) -> Iterator[Finding]:
    if not isinstance(subject.prior, Refiner):
        return

    def refined(known: Observations) -> Samples:
        """What the prior corrects of a finished fit, of which nothing else is known: half rough, a little off, matt."""
        masks = known.masks[..., None]
        more = {"radiance": 0.9 * known.images, "roughness": 0.5 * masks, "evidence": 0.1 * masks.expand(-1, -1, -1, 2).clone()}
        return subject.watched(subject.prior.refine, known, frozenset(), renders={**_fitted(known), **more})

    empty = _with_empty_view(subject.known)
    corrected, of_empty_view = refined(subject.known), refined(empty)
    what, expected = "a corrected fit", "a finite albedo, and roughness up to 1, zero where the mask is; of an empty view, too"
    try:
        for one in (corrected, of_empty_view):
            checked(type(subject.prior).__qualname__, "refine", one, None, tuple(subject.known.images.shape))
    except InputError as error:
        yield Finding("fail", what, expected, str(error))
        return
    both = (corrected, subject.known.masks), (of_empty_view, empty.masks)
    outside = max(float(maps[masks == 0].abs().max()) for one, masks in both for maps in one.values.values())
    rough = float(corrected.values.get("roughness", torch.zeros(1)).max())
    found = f"at most {outside:.3g} outside, roughness up to {rough:.3g}"
    yield judge(outside <= 1e-6 and rough <= 1 + 1e-6, what, expected, found)
    yield _same("corrected again", corrected, refined(subject.known))
    yield _beside_others("one corrected on its own", refined(subject.known.select([0])).values, corrected)


def _with_geometry(subject: Subject) -> Iterator[Finding]:
    if subject.info.wants.isdisjoint(GEOMETRY):
        return
    sampled = partial(subject.watched, subject.prior.sample, hidden=frozenset(), guidance=None, seed=0)
    samples = sampled(subject.known)
    yield _judge_sound(subject, "a sample with geometry", samples, subject.known)
    sampled(subject.known.select([1]))  # which brings other geometry
    yield _same("the same geometry again", samples, sampled(subject.known))


def _kept(subject: Subject) -> Iterator[Finding]:
    """What has been so all the while: inputs as they were, costs counted, a fingerprint."""
    if (value := fingerprint_of(subject.prior)) is not None:
        yield judge(bool(value), "fingerprint", "a text", f"{value!r:.300}")
    yield judge(not subject.modified, "inputs", "nothing modified", ", ".join(sorted(subject.modified)))
    if subject.forwards:
        calls = subject.network_calls
        yield judge(calls > 0, "cost: network_calls", "some, because the prior asks a network", f"{calls} in all samples")


RULES: dict[str, Callable[[Subject], Iterator[Finding]]] = {
    "a sample": lambda subject: _sound(subject, subject.base, subject.known),
    "coupling": _recommended,
    "other images": _other_images,
    "seeds": _repeatable,
    "an image on its own": _independent,
    "guidance": _guided,
    "distillation": _distilled,
    "refinement": _refined,
    "geometry": _with_geometry,
    "inputs": _kept,
}
"""Every rule after the declared members, in order, by the name that stands for it where it raises."""
