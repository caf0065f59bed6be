"""What every prior with networks of this project shares: weights, framing, encoding."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.files import hash_of_files, is_file
from ia_bench.common.paths import PACKAGE
from ia_bench.common.ranges import Number
from ia_bench.common.seeds import derive_seed
from ia_bench.priors.contract import COMPONENTS, Observations, PriorInfo, Samples
from ia_bench.priors.diffusion import encoding
from ia_bench.priors.diffusion.encoding import Frame, enlarge, enlarge_by_difference, enlarge_by_gain
from ia_bench.priors.diffusion.network import DESCRIPTION, FILES, Conditioned, MaterialNetwork, NetworkConfig, load_network
from ia_bench.priors.inputs import Device, Precision, choose_device, content_number, use_bf16
from ia_bench.priors.weight_files import read_description

PACKAGED = PACKAGE / "priors" / "weights"
VERSION = 6  # part of the fingerprint; raised when a change of the code changes samples


@dataclass(frozen=True)
class Framed:
    """Images that share one size, ready for a network.

    ``frames``: by the number of the caller's image; ``seeds``, one per image; ``condition`` (N, K, S, S); ``masks`` (N, S, S);
    exposure ``factor`` (N,).
    """

    frames: dict[int, Frame]
    seeds: list[int]
    condition: Tensor
    masks: Tensor
    factor: Tensor


def cut(values: Tensor, frames: Mapping[int, Frame]) -> Tensor:
    """The squares (N, S, S, C) at ``frames`` of values (V, H, W, C) of all images."""
    return torch.stack([frame.cut(values[view]) for view, frame in frames.items()])


Predict = Callable[[MaterialNetwork, Framed, Mapping[str, Tensor], Counter[str]], Tensor]


def weights_folder(weights: str | None, kind: str) -> Path:
    """The folder of weights that an option names, or that of the package with those of this ``kind``."""
    return Path(weights).expanduser() if weights else PACKAGED / kind


@dataclass(kw_only=True, eq=False)
class LearnedPrior(ABC):
    """Base of the priors with networks.

    Attributes:
        weights: A folder that ia_bench_training.train wrote, one with a folder for each component in it, or None for the
            weights that come with the package.
        geometry: Let the network see normals and visibility where a scene has them.
        batch: Images at a time, which changes no sample beyond rounding.
        precision: float32, bf16, or auto (bf16 on a GPU).
        device: auto, cpu or cuda; auto is CUDA where there is some, but the CPU in a run with device=cpu.

    Raises:
        InputError: The weights cannot be used.
    """

    kind: ClassVar[str]  # of its networks, and the name of its packaged weights
    stochastic: ClassVar[bool]  # and guidable: without noise there is nothing to draw
    weights: str | None = None
    geometry: bool = False
    batch: Number = 64
    precision: Precision = "auto"
    device: Device = "auto"

    @classmethod
    def resolved_options(cls, options: Mapping[str, Any]) -> dict[str, Any]:
        """The options with what precision "auto" means on this machine: it decides samples, and so is part of a run's identity."""
        bf16 = use_bf16(options.get("precision", "auto"), choose_device(options.get("device", "auto")))
        return {**options, "precision": "bf16" if bf16 else "float32"}

    @classmethod
    def files(cls, options: Mapping[str, Any]) -> list[Path]:
        """What samples depend on beside code and options: the weights."""
        return [weights_folder(options.get("weights"), cls.kind)]

    def __post_init__(self) -> None:
        folder = weights_folder(self.weights, self.kind)
        self._device = choose_device(self.device)
        self.bf16 = use_bf16(self.precision, self._device)
        self._parts = [folder / name for name in COMPONENTS if (folder / name / DESCRIPTION).is_file()] or [folder]
        self._configs = [read_description(part / DESCRIPTION, NetworkConfig)[0] for part in self._parts]
        for part, config in zip(self._parts, self._configs, strict=True):
            if config.kind != self.kind:
                raise InputError(f"{part}/prior.json: kind: expected {self.kind}, found {config.kind}")
            if self.geometry and not config.geometry:
                raise InputError(f"prior.options.geometry=true: {part}: expected weights trained with geometry, found none of it")
        sizes, components = [config.size for config in self._configs], [name for each in self._configs for name in each.components]
        if len(set(sizes)) > 1 or len(set(components)) < len(components):
            found = f"sizes {sizes} and components {', '.join(components)}"
            raise InputError(f"{folder}: expected networks of one size without a component in common, found {found}")
        wants = frozenset({"normals", "visibility"} if self.geometry else ())
        self.info = PriorInfo(frozenset(components), self.stochastic, self.stochastic, sizes[0], wants=wants)
        self._native = sizes[0]

    @property
    def fingerprint(self) -> str:
        """What decides the samples: this code's version, the options, the content of the weights."""
        files = {part: [file for name in (DESCRIPTION, *FILES) if is_file(file := part / name)] for part in self._parts}
        content = [hash_of_files(*each) for each in files.items()]
        where = [self._device.type, "bf16" if self.bf16 else "float32", self.batch]  # which decide the last bits
        options = {"geometry": self.geometry, **self._options()}
        return json.dumps([type(self).__qualname__, VERSION, options, where, content], sort_keys=True)

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        """See :meth:`ia_bench.priors.contract.Prior.sample`.

        An image's noise is seeded by ``seed`` and the image's own content, so that views differ in it, and by the component
        where networks have one each.
        """
        return self._through(observations, seed, guidance or {}, self._predict)

    def _conditioned(self, network: MaterialNetwork, cost: Counter[str]) -> Conditioned:
        return Conditioned(network, chunk=self.batch, bf16=self.bf16, cost=cost)

    def _options(self) -> dict[str, Any]:
        """The options that change samples, besides those of this class."""
        return {}

    def _patched(self, reduction: float) -> bool:
        """Whether an image of so many pixels per native pixel is predicted in patches of the native size, not reduced to it."""
        return False

    @abstractmethod
    def _predict(self, network: MaterialNetwork, framed: Framed, render: Mapping[str, Tensor], cost: Counter[str]) -> Tensor:
        """(N, 3 C, S, S) in the network's space; ``render``: encoded (N, 3, S, S) per component to be drawn toward.

        What it takes is added to ``cost``.
        """

    def _through(
        self, observed: Observations, seed: int, renders: Mapping[str, Tensor], predict: Predict, *, reduced: bool = False
    ) -> Samples:
        """Frame, ``predict``, bring back to size and decode; views without foreground stay black.

        ``reduced``: always to the native size, for a ``predict`` that knows no patches.
        """
        images, masks = observed.images, observed.masks
        samples = {name: torch.zeros_like(images, dtype=torch.float32) for name in sorted(self.info.provides)}
        ceiling, cost = torch.full((len(images),), torch.inf), Counter(network_calls=0)
        for network in self._networks:
            components = network.config.components
            for framed in self._framed(observed, seed, network.config, reduced=reduced):
                encoded = {
                    name: encoding.encode(name, cut(render, framed.frames), framed.masks, framed.factor).to(self._device)
                    for name, render in renders.items()
                    if name in components
                }
                predicted = predict(network, framed, encoded, cost).float().cpu()
                if "specular" in components:  # which ends at the white of its encoding
                    ceiling[list(framed.frames)] = 1.0 / framed.factor
                for name, part in zip(components, predicted.split(3, 1), strict=True):
                    for row, (view, frame) in enumerate(framed.frames.items()):
                        mask, factor = masks[view].float()[None], framed.factor[row : row + 1]
                        place, known = (frame, _display(part[row])), (framed.masks[row] > 0).float()
                        if name in encoded:
                            full = encoding.encode(name, renders[name][view][None].float(), mask, factor)[0]
                            shown = enlarge_by_difference(*place, _display(encoded[name][row]), _display(full), known)
                        elif name == "albedo":
                            full = encoding.encode_image(images[view][None].float(), mask, factor)[0, :3]
                            shown = enlarge_by_gain(*place, _display(framed.condition[row, :3]), _display(full), known)
                        else:
                            shown = enlarge(*place, known, mask[0].shape)
                        samples[name][view] = encoding.decode(name, (2 * shown - 1).movedim(-1, 0)[None], mask, factor)[0]
        return Samples(samples, {"specular": ceiling} if "specular" in samples else {}, dict(cost))

    @cached_property
    def _networks(self) -> list[MaterialNetwork]:
        return [load_network(part)[0].to(self._device) for part in self._parts]

    def _framed(self, observed: Observations, seed: int, config: NetworkConfig, *, reduced: bool) -> list[Framed]:
        """The images grouped by the size at which they are predicted, at most ``batch`` at a time."""
        images, masks = observed.images.float(), observed.masks.float()
        groups: dict[int, dict[int, Frame]] = {}
        for view, mask in enumerate(masks):
            frame = Frame.around(mask, self._native)
            if frame is None:
                continue
            if not reduced and self._patched(frame.length / self._native):
                frame = Frame.around(mask, None) or frame
            groups.setdefault(frame.side, {})[view] = frame
        found = []
        for members in groups.values():
            for start in range(0, len(members), self.batch):
                frames = dict(list(members.items())[start : start + self.batch])
                seeds = [derive_seed(seed, content_number(images[view], masks[view])) for view in frames]
                if len(config.components) < len(COMPONENTS):  # or networks of one component each would draw from the same noise
                    seeds = [derive_seed(one, COMPONENTS.index(config.components[0]), 0) for one in seeds]
                radiance, coverage = cut(images, frames), cut(masks[..., None], frames)[..., 0].clamp(0, 1)
                factor = encoding.exposure(radiance, coverage)
                condition = encoding.encode_image(radiance, coverage, factor)
                if config.geometry:
                    seen = condition.new_zeros(len(frames), 4, *condition.shape[-2:])  # as in training where nobody knows it
                    if self.geometry and observed.normals is not None and observed.visibility is not None:
                        seen = encoding.encode_geometry(cut(observed.normals, frames), cut(observed.visibility, frames))
                    condition = torch.cat([condition, seen], 1)
                found.append(Framed(frames, seeds, condition.to(self._device), coverage, factor))
        return found


class RegressorPrior(LearnedPrior):
    """The paper's "data-driven" alternative: a network of the diffusion prior's size, data and training, without noise.

    It returns the mean of what the image could mean, always the same; so there is nothing to guide.
    """

    kind = "regressor"
    stochastic = False

    @torch.no_grad()
    def _predict(self, network: MaterialNetwork, framed: Framed, render: Mapping[str, Tensor], cost: Counter[str]) -> Tensor:
        return self._conditioned(network, cost).regress(framed.condition)


def _display(encoded: Tensor) -> Tensor:
    """(3, H, W) in the network's space as display values (H, W, 3) in [0, 1]."""
    return (0.5 + 0.5 * encoded.cpu()).clamp(0, 1).movedim(0, -1)
