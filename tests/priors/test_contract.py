"""The priors that come with the project keep the contract, and the protocol classes tell them from other objects."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

from ia_bench.checks.conformance import check_prior
from ia_bench.checks.painted_ball import painted_ball
from ia_bench.common.declared import Declared
from ia_bench.common.errors import InputError, PluginError
from ia_bench.priors.contract import Observations, PriorInfo, Samples
from ia_bench.priors.oracle import OraclePrior
from ia_bench.priors.validation import ask, ask_to_distill, check_prior_info, fingerprint_of
from ia_bench.scenes.scene import View

DIALS = {"scale": 0.02, "noise": 0.02, "baked": 0.2, "inconsistency": 0.05}


ALBEDO_ALONE = {"components": ["albedo"], "noise": 0.02}


@pytest.mark.parametrize("options", [{}, DIALS, ALBEDO_ALONE], ids=["exact", "dials", "albedo"])
def test_oracle_conforms(options: dict) -> None:
    findings = list(check_prior(lambda: OraclePrior(**options), painted_ball(16, 24, 3)))
    assert [finding for finding in findings if finding.status == "fail"] == []
    assert len(findings) > 15
    assert [finding.what for finding in findings if finding.status == "skip"] == ["an image on its own"]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"provides": {"albedo"}}, "provides: expected a frozenset of some of albedo, specular, found {'albedo'}"),
        ({"encoding": {"albedo": "log"}}, "encoding: expected one of linear, srgb for every component provided, found"),
        ({"wants": frozenset({"depth"})}, "wants: expected a frozenset of some of normals, visibility, view_count, truth, found"),
        ({"wants": frozenset({"truth"})}, "wants: expected sees_truth=True of a prior that wants truth, found False"),
    ],
)
def test_an_info_that_cannot_be_meant_is_refused(fields: dict, message: str) -> None:
    with pytest.raises(InputError, match=f"^{message}"):
        PriorInfo(**{"provides": frozenset({"albedo"}), **fields})


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("resolution", 0, "1 or more"),
        ("coupling", "", "some text"),
        ("stochastic", "no", "true or false"),
        ("sees_truth", None, "true or false"),
        ("declared", {}, "a Declared"),
        ("declared.seconds", math.nan, "a finite number"),
    ],
)
def test_what_a_prior_says_of_another_type_is_refused_before_it_is_asked(field: str, value: object, expected: str) -> None:
    part, _, inner = field.partition(".")
    said = {part: Declared(**{inner: value}) if inner else value}
    prior = SimpleNamespace(info=PriorInfo(frozenset({"albedo"}), **said), sample=print)
    with pytest.raises(PluginError, match=f"^prior SimpleNamespace: info: .*{field.split('.')[-1]}: expected {expected}, found "):
        check_prior_info(prior)


def test_copies_share_no_memory_and_a_selection_keeps_the_order() -> None:
    known = replace(BALL, views=(4, 6, 9))
    copied = known.copy()
    for tensor in tensors_of(copied):
        tensor.fill_(7)
    part = known.select([2, 0])
    assert part.views == (9, 4)
    for kept, whole in zip(tensors_of(part), tensors_of(painted_ball(7, 9, 3)), strict=True):
        assert torch.equal(kept, whole[[2, 0]])


BALL = painted_ball(7, 9, 3)
GRADIENT = torch.ones(1, requires_grad=True)


def tensors_of(known: Observations) -> list[Tensor]:
    return [value for value in vars(known).values() if isinstance(value, Tensor)] + list(known.truth.values())


class Answering:
    """A prior that answers what it is told, or does what it is told."""

    info = PriorInfo(frozenset({"albedo", "specular"}), guidable=True)

    def __init__(self, answer: Callable[[Observations], Any]) -> None:
        self.answer = answer

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Any:
        return self.answer(observations)

    def distill(self, observations: Observations, renders: Mapping[str, Tensor], *, seed: int) -> Any:
        return self.answer(observations)


def good(shown: Observations, **changes: Any) -> Samples:
    values = {"albedo": 0.5 * shown.images, "specular": shown.images.clone(), **changes}
    return Samples(values, {"specular": torch.full((3,), torch.inf)}, {"network_calls": 3})


def edit(change: Callable[[Tensor], Any]) -> Callable[[Observations], Samples]:
    """The albedo passes through ``change``."""
    return lambda shown: good(shown, albedo=change(0.5 * shown.images))


def changed(**parts: Any) -> Callable[[Observations], Samples]:
    return lambda shown: replace(good(shown), **parts)


WRONG: dict[str, tuple[Callable[[Observations], Any], str]] = {
    # what is wrong: the answer, what the message says after the prior's name
    "nothing": (lambda shown: None, "expected ia_bench.priors.contract.Samples, found NoneType"),
    "a component too few": (changed(values={"albedo": 0}), "values: expected albedo, specular, found albedo"),
    "numpy": (edit(lambda albedo: albedo.numpy()), "albedo: expected a tensor, found ndarray"),
    "double": (edit(Tensor.double), r"albedo: expected type float32, found float64"),
    "channels first": (edit(lambda albedo: albedo.movedim(-1, 1)), r"albedo: expected shape \(3, 7, 9, 3\), found \(3, 3, 7, 9\)"),
    "another device": (edit(lambda albedo: albedo.to("meta")), "albedo: expected device cpu, found meta"),
    "with gradient": (edit(lambda albedo: albedo * GRADIENT), "albedo: expected requires_grad False, found True"),
    "NaN": (
        edit(lambda albedo: albedo.index_fill(1, torch.tensor(3), torch.nan)),
        "albedo: expected finite values, found NaN or Inf in 81 of 567",
    ),
    "a ceiling of what is not provided": (changed(ceilings={"roughness": torch.ones(3)}), "ceilings: .* found roughness"),
    "a ceiling that is a number": (changed(ceilings={"specular": 1.0}), "ceiling of specular: expected a tensor, found float"),
    "a ceiling of zero": (changed(ceilings={"specular": torch.zeros(3)}), "ceiling of specular: expected values > 0, found 0"),
    "a cost with a line break in its name": (changed(cost={"a\n": 1}), r"cost: expected .*'a\\n': 1"),
    "a negative cost": (changed(cost={"network_calls": -1}), "cost: expected .*'network_calls': -1"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_answers_are_refused_in_one_line_that_names_the_prior(name: str) -> None:
    answer, message = WRONG[name]
    for method, call in (
        ("sample", lambda prior: ask(prior, BALL, seed=0)),
        ("distill", lambda prior: ask_to_distill(prior, BALL, {"albedo": BALL.images, "specular": BALL.images}, seed=0)),
    ):
        with pytest.raises(InputError, match=rf"^prior Answering: {method}\(\): {message}") as caught:
            call(Answering(answer))
        assert "\n" not in str(caught.value)


def test_what_is_right_passes_in_memory_of_its_own() -> None:
    handed: list[Samples] = []

    def answer(shown: Observations) -> Samples:
        handed.append(good(shown, albedo=shown.images[..., :1].expand(shown.images.shape)))  # one number three times
        return handed[0]

    samples = ask(Answering(answer), BALL, seed=0)
    before = {name: value.clone() for name, value in samples.values.items()}
    handed[0].values["specular"].fill_(7)
    assert all(torch.equal(value, before[name]) for name, value in samples.values.items())
    assert samples.values["albedo"].is_contiguous()
    assert samples.cost == {"network_calls": 3}
    assert torch.equal(samples.ceilings["specular"], torch.full((3,), torch.inf))


def test_a_prior_that_changes_its_inputs_changes_nothing_else() -> None:
    kept, renders = BALL.copy(), {"albedo": BALL.images}

    class Spoiling(Answering):
        def sample(self, observations: Observations, *, seed: int, guidance: Any = None) -> Samples:
            samples = good(observations)
            for tensor in (*tensors_of(observations), *guidance.values()):
                tensor.fill_(torch.nan)
            guidance.clear()
            return samples

    ask(Spoiling(good), BALL, seed=0, guidance=renders)
    assert all(map(torch.equal, tensors_of(BALL), tensors_of(kept)))
    assert torch.equal(renders["albedo"], kept.images)


@pytest.mark.parametrize("what", ["images", "masks", "normals", "renders of albedo"])
def test_what_is_not_finite_is_shown_to_no_prior(what: str) -> None:
    known, renders = BALL.copy(), {"albedo": BALL.images.clone(), "specular": BALL.images}
    (renders["albedo"] if what == "renders of albedo" else getattr(known, what))[1, 3, 3] = torch.nan
    prior = Answering(failing(AssertionError("it was asked")))
    for method, call in (
        ("sample", lambda: ask(prior, known, seed=0, guidance=renders)),
        ("distill", lambda: ask_to_distill(prior, known, renders, seed=0)),
    ):
        with pytest.raises(InputError, match=rf"^prior Answering: {method}\(\): expected finite {what} to show it, found NaN"):
            call()


def failing(error: BaseException) -> Callable[[Observations], Any]:
    def answer(shown: Observations) -> Any:
        raise error

    return answer


@pytest.mark.parametrize(
    ("error", "said"),
    [(RuntimeError("\ud800 here"), r"RuntimeError: \ud800 here"), (GeneratorExit(), "GeneratorExit: no message")],
    ids=["surrogate", "GeneratorExit"],
)
def test_whatever_a_prior_raises_is_one_line_that_can_be_printed(error: BaseException, said: str) -> None:
    with pytest.raises(PluginError) as caught:
        ask(Answering(failing(error)), BALL, seed=0)
    assert str(caught.value).startswith(f"prior Answering raised {said} (test_contract.py:")
    assert str(caught.value).isprintable()
    with pytest.raises(PluginError, match="^prior Answering raised"):
        ask_to_distill(Answering(failing(error)), BALL, {"albedo": BALL.images}, seed=0)


class Informed(Answering):
    """One whose info is a property that can fail."""

    @property
    def info(self) -> Any:  # type: ignore[override]
        return self.answer(BALL)


@pytest.mark.parametrize(
    ("prior", "message"),
    [
        (object(), r"prior object: info: expected a ia_bench\.priors\.contract\.PriorInfo, found None"),
        (Informed(lambda shown: {"provides": {"albedo"}}), r"prior Informed: info: expected .*, found {'provides': {'albedo'}}"),
        (Informed(failing(RuntimeError("no weights"))), "prior Informed raised RuntimeError: no weights"),
        (View, "prior type: info: expected"),
        (type("Bare", (), {"info": Answering.info})(), r"prior Bare: expected a method sample\(observations.*, found none"),
    ],
)
def test_what_is_no_prior_is_told_before_it_is_asked(prior: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        check_prior_info(prior)


class Printed(Answering):
    """One whose fingerprint is a property that can fail."""

    @property
    def fingerprint(self) -> Any:
        return self.answer(BALL)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (failing(AttributeError("weights")), "prior Printed raised AttributeError: weights"),
        (lambda shown: 3, "prior Printed: fingerprint: expected a text, found 3"),
    ],
)
def test_a_fingerprint_that_fails_or_is_no_text_is_not_taken_for_none(answer: Callable[[Observations], Any], message: str) -> None:
    assert fingerprint_of(Answering(answer)) is None
    with pytest.raises(PluginError, match=message):
        fingerprint_of(Printed(answer))
