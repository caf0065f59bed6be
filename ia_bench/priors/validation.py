"""The one place where a prior is called: it gets copies of finite images, and what it answers is checked before anybody uses it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.errors import InputError, PluginError
from ia_bench.common.registry import at_work
from ia_bench.common.settings import check_fields
from ia_bench.priors.contract import Distiller, Observations, Prior, PriorInfo, Refiner, Samples

ABOVE = 0.01  # an albedo so little beyond its range is one of rounding, or of an interpolation
MOST = 2**63  # counters and seconds are below it
LARGEST = 1e6
"""Linear values above this, and negative ones, are counted: no scene has them, but nothing breaks because of them."""


def check_prior_info(prior: Any) -> None:  # noqa: ANN401 (anything may claim to be a prior)
    """Raise PluginError unless ``prior`` says of itself what every user of it asks first."""
    with at_work("prior", name_of(prior)):
        info = getattr(prior, "info", None)
    if not isinstance(info, PriorInfo):
        raise PluginError(f"prior {name_of(prior)}: info: expected a {PriorInfo.__module__}.PriorInfo, found {info!r:.100}")
    check_fields(info, f"prior {name_of(prior)}: info: ")
    if info.declared is not None:
        check_fields(info.declared, f"prior {name_of(prior)}: info: declared: ")
    if not callable(getattr(prior, "sample", None)):
        raise PluginError(f"prior {name_of(prior)}: expected a method sample(observations, *, seed, guidance=None), found none")


def fingerprint_of(prior: Any) -> str | None:  # noqa: ANN401 (anything may claim to be a prior)
    """The ``fingerprint`` of a prior, None of one that has none. Raises PluginError for one that cannot be asked or is no text."""
    with at_work("prior", name_of(prior)):
        told = "fingerprint" in dir(prior)  # whose AttributeError a default would hide
        found = prior.fingerprint if told else getattr(prior, "fingerprint", None)
    if not isinstance(found, str | None):
        raise PluginError(f"prior {name_of(prior)}: fingerprint: expected a text, found {found!r:.100}")
    return found


def refiner_of(prior: Prior) -> Refiner:
    """The prior, as one that corrects fits. Raises InputError for one that cannot."""
    if not isinstance(prior, Refiner):
        found = f"found {name_of(prior)}, which has none"
        raise InputError(f"fit.regularise: expected a prior with a method refine(observations, renders), {found}")
    return prior


def ask(prior: Prior, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
    """The prior's samples, checked and in memory of their own. Raises PluginError, naming the prior, for anything else.

    Raises InputError where what it is to be shown is not finite.
    """
    provides = prior.info.provides
    return _asked(
        prior, "sample", provides, observations, guidance, lambda shown, copies: prior.sample(shown, seed=seed, guidance=copies)
    )


def ask_to_distill(prior: Distiller, observations: Observations, renders: Mapping[str, Tensor], *, seed: int) -> Samples:
    """The prior's estimates of ``renders``, checked like samples."""
    provides = frozenset(renders)
    return _asked(prior, "distill", provides, observations, renders, lambda shown, copies: prior.distill(shown, copies, seed=seed))


def ask_to_refine(prior: Refiner, observations: Observations, renders: Mapping[str, Tensor]) -> Samples:
    """The material of ``renders`` as the prior corrects it, checked like samples."""
    return _asked(prior, "refine", None, observations, renders, lambda shown, copies: prior.refine(shown, copies))


def _asked(
    prior: object,
    method: str,
    provides: frozenset[str] | None,
    observations: Observations,
    renders: Mapping[str, Tensor] | None,
    call: Callable[[Observations, Any], Samples],
) -> Samples:
    images = {**vars(observations), **{f"renders of {name}": render for name, render in (renders or {}).items()}}
    for what, values in images.items():
        if isinstance(values, Tensor) and not bool(values.isfinite().all()):
            raise InputError(f"prior {name_of(prior)}: {method}(): expected finite {what} to show it, found NaN or Inf")
    copies = None if renders is None else {name: render.clone() for name, render in renders.items()}
    with at_work("prior", name_of(prior)):
        samples = call(observations.copy(), copies)
    return checked(name_of(prior), method, samples, provides, observations.images.shape)


def name_of(prior: object) -> str:
    """The class of a prior; of an adapter, what it says it stands for."""
    return str(getattr(prior, "stands_for", type(prior).__qualname__))


def checked(name: str, method: str, samples: Any, provides: frozenset[str] | None, shape: tuple[int, ...]) -> Samples:  # noqa: ANN401
    """``samples`` with tensors of their own, if they are what the contract says of images of ``shape`` (V, H, W, 3).

    They must hold what is in ``provides``, or for None (a refined material) an albedo and perhaps a roughness.
    """
    who = f"prior {name}: {method}()"
    if not isinstance(samples, Samples):
        raise PluginError(f"{who}: expected {Samples.__module__}.Samples, found {type(samples).__name__}")
    for part in ("values", "ceilings", "cost"):
        if not isinstance(getattr(samples, part), Mapping):
            raise PluginError(f"{who}: {part}: expected a mapping, found {type(getattr(samples, part)).__name__}")
    wanted = sorted({"albedo", *({"roughness"} & set(samples.values))} if provides is None else provides)
    if sorted(map(str, samples.values)) != wanted:
        found = ", ".join(map(str, samples.values)) or "nothing"
        raise PluginError(f"{who}: values: expected {', '.join(wanted) or 'nothing'}, found {found}")
    shapes = {component: (*shape[:-1], 1 if component == "roughness" else 3) for component in wanted}
    values = {component: _tensor(f"{who}: {component}", samples.values[component], shapes[component]) for component in wanted}
    ceilings = {}
    for component, ceiling in samples.ceilings.items():
        if component not in wanted:
            raise PluginError(f"{who}: ceilings: expected some of {', '.join(wanted)}, found {component}")
        ceilings[component] = _tensor(f"{who}: ceiling of {component}", ceiling, (shape[0],), endless=True)
        if not bool((ceilings[component] > 0).all()):
            raise PluginError(f"{who}: ceiling of {component}: expected values > 0, found {float(ceilings[component].min()):g}")
    for what, count in samples.cost.items():
        named = isinstance(what, str) and what.isprintable()  # as every counter of a run is
        if not named or isinstance(count, bool) or not isinstance(count, int) or not 0 <= count < MOST:
            raise PluginError(f"{who}: cost: expected names with whole numbers >= 0, found {what!r}: {count!r:.100}")
    return Samples(values, ceilings, dict(samples.cost))


def beyond_a_material(samples: Samples, masks: Tensor) -> str | None:
    """What is wrong with an albedo by itself, in words: above 1, or where the ``masks`` (V, H, W) have no object; None: nothing."""
    albedo = samples.values.get("albedo")
    if albedo is None or not albedo.numel():
        return None
    largest = float(albedo.max())
    if largest > 1 + ABOVE:
        return f"an albedo up to {largest:.3g}, expected 0 to 1"
    outside = int(((masks.to(albedo.device) == 0)[..., None] & (albedo > ABOVE)).any(-1).sum())
    return f"an albedo in {outside} pixels outside of the masks, expected 0 there" if outside else None


def _tensor(what: str, value: Any, shape: tuple[int, ...], *, endless: bool = False) -> Tensor:  # noqa: ANN401
    """A copy of ``value``, if it is a plain float32 tensor of ``shape`` on the CPU; ``endless``: which may hold Inf."""
    check_numbers(what, value, "cpu")
    if tuple(value.shape) != shape:
        raise PluginError(f"{what}: expected shape {shape}, found {tuple(value.shape)}")
    bad = int((value.isnan() if endless else ~value.isfinite()).sum())
    if bad:
        raise PluginError(f"{what}: expected finite values, found NaN or Inf in {bad} of {value.numel()}")
    return value.clone(memory_format=torch.contiguous_format)


def check_numbers(what: str, value: Any, device: str) -> None:  # noqa: ANN401 (whatever a plug-in gave)
    """Raise PluginError unless ``value`` is a plain float32 tensor of the ``device`` without gradient, or with none an array."""
    if not isinstance(value, Tensor if device else np.ndarray):
        raise PluginError(f"{what}: expected {'a tensor' if device else 'an array'}, found {type(value).__name__}")
    facts: list[tuple[str, object, object]] = [("type", "float32", value.dtype)]
    if isinstance(value, Tensor):
        facts += [("layout", "strided", value.layout), ("device", device, value.device.type)]
        facts += [("requires_grad", False, value.requires_grad)]
    for fact, expected, found in facts:
        if str(found).removeprefix("torch.") != str(expected):
            raise PluginError(f"{what}: expected {fact} {expected}, found {str(found).removeprefix('torch.')}")
