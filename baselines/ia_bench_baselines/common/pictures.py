"""Priors whose network takes one small square display picture: framing, exposure, encoding, weights and the way back to size."""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import torch
from safetensors.torch import save_file
from torch import Tensor, nn

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.priors.contract import Observations, PriorInfo, Samples
from ia_bench.priors.diffusion import encoding
from ia_bench.priors.diffusion.encoding import Frame, enlarge, enlarge_by_gain
from ia_bench.priors.weight_files import fill

SIDE = 64  # pixels of the square that the networks see, which is what the training images have


class PicturePrior(ABC):
    """Base of the deterministic priors with one network of 64 x 64 pixels.

    A subclass names itself (``kind``), says what it provides (``info``), where its packaged weights lie and how its network is
    made, and answers for one picture. ``weights``: a file that its ``train`` wrote, None for the packaged one.
    """

    kind: ClassVar[str]
    info: PriorInfo
    version: ClassVar[int] = 1  # part of the fingerprint; raised when a change of the code changes samples

    def __init__(self, *, weights: str | None = None) -> None:
        self._path = Path(weights).expanduser() if weights else self.packaged()
        if not self._path.is_file():
            raise InputError(f"prior={self.kind}: {self._path}: expected a file of weights, found none")

    @staticmethod
    @abstractmethod
    def packaged() -> Path:
        """The weights that come with the package."""

    @staticmethod
    @abstractmethod
    def make_network() -> nn.Module:
        """The network that the weights belong to."""

    @abstractmethod
    def predict(self, network: nn.Module, picture: Tensor) -> dict[str, Tensor]:
        """Display values (1, 3, S, S) in [0, 1] of every component that is provided.

        ``picture`` (1, 4, S, S) is what ``encoding.encode_image`` makes: colour in [-1, 1], 0 outside the mask, and the mask.
        """

    @property
    def fingerprint(self) -> str:
        """What decides the samples: the class, the version of its code and the content of the weights."""
        content = hashlib.sha256(self._path.read_bytes()).hexdigest()
        return json.dumps([type(self).__qualname__, self.version, content])

    @torch.no_grad()
    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        """See :meth:`ia_bench.priors.contract.Prior.sample`. Nothing is random, and nothing can be guided."""
        values = {name: torch.zeros_like(observations.images, dtype=torch.float32) for name in sorted(self.info.provides)}
        white, calls = torch.full((len(observations.images),), torch.inf), 0
        for view, (image, mask) in enumerate(zip(observations.images.float(), observations.masks.float(), strict=True)):
            frame = Frame.around(mask, SIDE)
            if frame is None:
                continue
            cut = frame.cut(torch.cat([image, mask[..., None]], -1))[None]
            radiance, coverage = cut[..., :3], cut[..., 3].clamp(0, 1)
            factor = encoding.exposure(radiance, coverage)
            picture = encoding.encode_image(radiance, coverage, factor)
            predicted, known = self.predict(self._network, picture), (coverage[0] > 0).float()
            seen, full = (_display(shown) for shown in (picture, encoding.encode_image(image[None], mask[None], factor)))
            for name, part in predicted.items():
                reduced = part[0].movedim(0, -1)
                if name == "albedo":
                    shown = enlarge_by_gain(frame, reduced, seen, full, known)
                else:
                    shown = enlarge(frame, reduced, known, mask.shape)
                values[name][view] = encoding.decode(name, (2 * shown - 1).movedim(-1, 0)[None], mask[None], factor)[0]
            white[view] = 1 / factor[0]
            calls += 1
        return Samples(values, {"specular": white} if "specular" in values else {}, {"network_calls": calls})

    @cached_property
    def _network(self) -> nn.Module:
        network = self.make_network()
        fill(network, self._path)
        return network.eval().requires_grad_(False)


def _display(picture: Tensor) -> Tensor:
    """Colour of a picture (1, 4, H, W) as display values (H, W, 3) in [0, 1]."""
    return (0.5 + 0.5 * picture[0, :3]).movedim(0, -1)


def save_weights(network: nn.Module, path: Path, about: Mapping[str, Any]) -> None:
    """Write ``network`` in half precision, and ``about`` (JSON values: data, steps, figures) into the file's metadata."""
    tensors = {name: value.detach().half().cpu().contiguous() for name, value in network.state_dict().items()}
    with whole_file(path) as partial:
        save_file(tensors, partial, metadata={"about": json.dumps(dict(about), sort_keys=True)})
