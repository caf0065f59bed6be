"""For every rule of the conformance check a prior that breaks it first: small changes of ``Sound``, which passes everything."""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ia_bench.priors.contract import Observations, PriorInfo, Samples


class Sound:
    """Keeps the contract: the image and half of it, plus a little noise, drawn toward the guidance."""

    info = PriorInfo(frozenset({"albedo", "specular"}), stochastic=True, guidable=True, resolution=64)

    def __init__(self, *, guidance_strength: float = 1.0) -> None:
        self.guidance_strength = guidance_strength

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        images, masks = observations.images, observations.masks
        generator = torch.Generator().manual_seed(seed)
        noise = 0.05 * torch.rand(images.shape[1:], generator=generator) * masks[..., None]
        samples = {"albedo": (images + noise).clamp(0, 1) * masks[..., None], "specular": 0.5 * images + noise}
        for name, render in (guidance or {}).items():
            gain = self.guidance_strength / (1 + self.guidance_strength)
            if gain:
                samples[name] = samples[name] + gain * (render - samples[name])
        return Samples(samples)


def changed(**members: object) -> type[Sound]:
    return type("Changed", (Sound,), members)


def without(name: str) -> type:
    """A class like Sound that lacks one member."""
    members = {key: value for key, value in vars(Sound).items() if key != name and not key.startswith("__")}
    return type("Lacking", (), {**members, "__init__": Sound.__init__})


def spoiled(spoil: Callable[..., object], **members: object) -> type[Sound]:
    """A prior whose samples ``spoil(samples, shown, guidance, prior)`` changes in their dictionary."""

    def sample(self: Sound, observations: Observations, *, seed: int, guidance: Any = None) -> Samples:
        values = dict(Sound.sample(self, observations, seed=seed, guidance=guidance).values)
        spoil(values, observations, guidance, self)
        return Samples(values)

    return changed(sample=sample, **members)


def edit(**changes: Callable[[Tensor], object]) -> type[Sound]:
    """Samples whose components are replaced by ``changes[component](sample)``."""
    return spoiled(lambda samples, *_: samples.update({name: f(samples[name]) for name, f in changes.items()}))


def put(component: str, value: float) -> type[Sound]:
    """One inner pixel of every sample gets this value."""
    return edit(**{component: lambda s: s.index_fill(1, torch.tensor(s.shape[1] // 2), value)})


def when_guided(change: Callable[[dict, Tensor, Mapping], object]) -> type[Sound]:
    """Samples that pass through ``change(samples, outside, guidance)`` where there is guidance; ``outside`` is 1 there."""
    return spoiled(lambda s, shown, guidance, _: guidance and change(s, (shown.masks == 0)[..., None].float(), guidance))


def dark_nan(samples: dict, shown: Observations, *_: object) -> None:
    brightest = shown.images.amax((1, 2, 3), keepdim=True)
    samples["albedo"] = samples["albedo"] * (brightest / brightest)


def lonely_nan(samples: dict, shown: Observations, *_: object) -> None:
    if bool((shown.masks.sum((1, 2)) == 0).any()):
        samples["albedo"] = samples["albedo"] * torch.nan


def square_only(samples: dict, shown: Observations, *_: object) -> None:
    if shown.images.shape[1] != shown.images.shape[2]:
        raise RuntimeError("mat1 and mat2 shapes cannot be multiplied")


def counting(samples: dict, shown: object, guidance: object, prior: Any) -> None:
    prior.drawn += 1
    samples["albedo"] /= prior.drawn


def forgetting(samples: dict, shown: object, guidance: object, prior: Any) -> None:
    prior.guided |= guidance is not None
    samples["albedo"] *= 0.9 if prior.guided and guidance is None else 1


def unequal(samples: dict, shown: object, guidance: object, prior: Any) -> None:
    prior.factor = prior.factor or 1 / next(INSTANCES)
    samples["albedo"] *= prior.factor


INSTANCES = itertools.count(1)


def other_seed_nan(self: Sound, observations: Observations, *, seed: int, guidance: object = None) -> Samples:
    values = Sound.sample(self, observations, seed=0).values
    return Samples({**values, "specular": values["specular"] * (torch.nan if seed else 1)})


def batch_of_one_nan(samples: dict, shown: Observations, *_: object) -> None:
    samples["specular"] = samples["specular"] * (len(shown.images) - 1) / (len(shown.images) - 1)


class Offering(Sound):
    """Everything that a prior may offer besides: a coupling, distillation, geometry, ceilings, a fingerprint."""

    info = replace(Sound.info, wants=frozenset({"visibility"}), coupling="distilled")
    fingerprint = "offering, version 1"
    end = 10.0

    def open_share(self, visibility: Tensor) -> Tensor:
        return visibility

    def sample(self, observations: Observations, *, seed: int, guidance: Any = None) -> Samples:
        values = dict(super().sample(observations, seed=seed, guidance=guidance).values)
        if observations.visibility is not None:
            values["albedo"] = values["albedo"] * self.open_share(observations.visibility)
        return Samples(values, {"specular": torch.full((len(observations.images),), self.end)})

    def distill(self, observations: Observations, renders: Mapping[str, Tensor], *, seed: int) -> Samples:
        level = float(torch.rand(1, generator=torch.Generator().manual_seed(seed)))
        seen = observations.images.clamp(max=1) * observations.masks[..., None]
        return Samples({name: 0.5 * level * render + 0.5 * seen for name, render in renders.items()})

    def refine(self, observations: Observations, renders: Mapping[str, Tensor]) -> Samples:
        return Samples({"albedo": 0.5 * renders["albedo"] * (1 + observations.visibility)})


def offering(**members: object) -> type[Offering]:
    return type("Changed", (Offering,), members)


class Remembering(Offering):
    """The geometry that it saw first stays with it."""

    openness: Tensor | None = None

    def open_share(self, visibility: Tensor) -> Tensor:
        first, self.openness = self.openness is None, visibility
        return visibility if first else 0.9 * visibility


def distill_as(change: Callable[[Mapping[str, Tensor]], dict]) -> Callable[..., Samples]:
    """A distillation whose estimates pass through ``change``."""
    return lambda self, shown, renders, *, seed: Samples(change(Offering.distill(self, shown, renders, seed=seed).values))


def refine_as(change: Callable[[Tensor], Tensor]) -> Callable[..., Samples]:
    """A correction that passes through ``change``."""
    return lambda self, shown, renders: Samples({"albedo": change(Offering.refine(self, shown, renders).values["albedo"])})


def paint_what_is_empty(self: Offering, shown: Observations, renders: Mapping[str, Tensor]) -> Samples:
    empty = (shown.masks.amax((1, 2), keepdim=True) == 0)[..., None]
    return Samples({"albedo": torch.where(empty, 0.7, Offering.refine(self, shown, renders).values["albedo"])})


def forty_times_as_rough(self: Offering, shown: Observations, renders: Mapping[str, Tensor]) -> Samples:
    return Samples({**Offering.refine(self, shown, renders).values, "roughness": 40 * renders["roughness"]})


class Pooling(Sound):
    """Blurs by a layer of torch, which has no weights and is no network."""

    def sample(self, observations: Observations, *, seed: int, guidance: Any = None) -> Samples:
        values = dict(super().sample(observations, seed=seed, guidance=guidance).values)
        blurred = torch.nn.AvgPool2d(3, 1, 1)(values["albedo"].movedim(-1, 1)).movedim(1, -1)
        return Samples({**values, "albedo": blurred * observations.masks[..., None]})


def by_brightest(albedo: Tensor) -> Tensor:
    return albedo / albedo.amax((1, 2, 3), keepdim=True)


def overwrite_renders(self: Offering, observations: Observations, renders: dict, *, seed: int) -> Samples:
    return Samples({name: render.mul_(0.5) for name, render in renders.items()})


def answering(**parts: Any) -> Callable[..., Samples]:
    """A sample of which some ``parts`` are others."""
    return lambda self, shown, *, seed, guidance=None: replace(Sound.sample(self, shown, seed=seed, guidance=guidance), **parts)


def brightened(self: Sound, observations: Observations, *, seed: int, guidance: Any = None) -> Samples:
    values = Sound.sample(self, observations, seed=seed, guidance=guidance).values
    return Samples({**values, "albedo": observations.images.copy_(values["albedo"])})


BROKEN: dict[str, tuple[Callable[[], object], str]] = {
    # what is wrong: a prior that does it, the first line that must fail (later ones may follow from it)
    "no info": (without("info"), "construction"),
    "no sample": (without("sample"), "construction"),
    "sample takes no seed": (changed(sample=lambda self, observations: {}), "a sample"),
    "NaN": (put("specular", torch.nan), "samples"),
    "above its ceiling": (offering(end=0.01), "specular: ceiling"),
    "albedo above 1": (put("albedo", 1.1), "albedo: range"),
    "negative light": (edit(specular=lambda s: -s), "specular: range"),
    "not premultiplied": (edit(specular=lambda s: s + 0.1), "specular: premultiplied"),
    "recommends a misspelt coupling": (changed(info=replace(Sound.info, coupling="kernal")), "coupling"),
    "recommends to distill what it cannot": (changed(info=replace(Sound.info, coupling="distilled")), "coupling"),
    "square images only": (spoiled(square_only), "other images"),
    "NaN in the dark": (spoiled(dark_nan), "all-black images"),
    "NaN for an empty mask": (spoiled(lonely_nan), "a view with an empty mask"),
    "stochastic but is not": (edit(albedo=lambda s: 0 * s, specular=lambda s: 0 * s), "another seed"),
    "stochastic undeclared": (changed(info=replace(Sound.info, stochastic=False)), "another seed"),
    "NaN for another seed": (changed(sample=other_seed_nan, info=replace(Sound.info, stochastic=False)), "another seed"),
    "torch's global generator": (spoiled(lambda s, *_: s["specular"].mul_(torch.rand(1))), "same seed again"),
    "counts its samples": (spoiled(counting, drawn=0), "same seed again"),
    "instances differ": (spoiled(unequal, factor=0.0), "same seed, new instance"),
    "normalised by the batch": (spoiled(lambda s, shown, *_: s["specular"].div_(0.1 + shown.images.mean())), "an image on its own"),
    "NaN for one image": (spoiled(batch_of_one_nan), "an image on its own"),
    "away from the guidance": (when_guided(lambda s, out, g: s["specular"].mul_(2).add_(1 - out)), "guided specular"),
    "guided outside the mask": (when_guided(lambda s, out, g: s["albedo"].add_(0.1 * out)), "guided sample"),
    "remembers guidance": (spoiled(forgetting, guided=False), "guidance = None afterwards"),
    "guided at strength 0": (when_guided(lambda s, out, g: s["albedo"].lerp_(g["albedo"], 0.5)), "guidance of strength 0"),
    "writes to images": (spoiled(lambda s, shown, *_: shown.images.mul_(0.5)), "inputs"),
    "writes to guidance": (when_guided(lambda s, out, g: g["albedo"].zero_()), "inputs"),
    "no table of costs": (changed(sample=answering(cost=None)), "samples"),
    "costs in words": (changed(sample=answering(cost={"network_calls": "three"})), "samples"),
    "writes to images and returns them": (changed(sample=brightened), "inputs"),
    "network not counted": (edit(albedo=torch.nn.PReLU(init=1.0).requires_grad_(False)), "cost: network_calls"),
    "distill takes no seed": (offering(distill=lambda self, observations, renders: {}), "distillation"),
    "distills one component": (offering(distill=distill_as(lambda e: {"albedo": e["albedo"]})), "distilled estimates"),
    "distills at random": (offering(distill=distill_as(lambda e: {n: v * torch.rand(1) for n, v in e.items()})), "distilled again"),
    "writes to renders": (offering(distill=overwrite_renders), "inputs"),
    "refine takes no renders": (offering(refine=lambda self, observations: {}), "refinement"),
    "refines to NaN": (offering(refine=refine_as(lambda a: a / a)), "a corrected fit"),
    "refines an empty view to NaN": (offering(refine=refine_as(by_brightest)), "a corrected fit"),
    "refines what is outside": (offering(refine=refine_as(lambda a: a + 0.1)), "a corrected fit"),
    "paints an empty view": (offering(refine=paint_what_is_empty), "a corrected fit"),
    "refines to more than rough": (offering(refine=forty_times_as_rough), "a corrected fit"),
    "refines at random": (offering(refine=refine_as(lambda a: a * torch.rand(1))), "corrected again"),
    "refines by the batch": (offering(refine=refine_as(lambda a: a / (0.1 + a.mean()))), "one corrected on its own"),
    "NaN with geometry": (offering(open_share=lambda self, visibility: visibility / visibility), "a sample with geometry"),
    "remembers other geometry": (Remembering, "the same geometry again"),
    "an empty fingerprint": (offering(fingerprint=""), "fingerprint"),
}
