"""Training batches from shards: images recoloured, mirrored, exposed and made noisy, then encoded for the network.

Light acts on image and specular shading alike and leaves the albedo as it is, so a colour cast costs nothing to render;
neither does another order of the colour channels.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.ranges import NotNegative, UnitInterval
from ia_bench.priors.diffusion import encoding
from ia_bench.priors.diffusion.encoding import encode_geometry, encode_image, exposure
from ia_bench.priors.diffusion.network import NetworkConfig
from ia_bench_training.shards import CHANNELS, load_shard, shard_paths

CPU = torch.device("cpu")


@dataclass(frozen=True)
class Augmentation:
    """What is changed at random in a training image.

    Attributes:
        mirror: Probability that left and right are exchanged.
        permute: Probability that the order of the colour channels is drawn anew, among all six.
        cast: Standard deviation of the light's log gain per channel.
        exposure: Half range of the log exposure error.
        noise: Largest standard deviation of sensor noise, relative to the image's exposure.
        tone: Standard deviation of the logarithm of a tone curve's exponent, on display values.
        eight_bits: Probability that a photograph has 8 bits.
        no_geometry: Probability that normals and visibility are withheld, so that one network serves images without them.
    """

    mirror: UnitInterval = 0.5
    permute: UnitInterval = 0.15
    cast: NotNegative = 0.2
    exposure: NotNegative = 0.3
    noise: NotNegative = 0.02
    tone: NotNegative = 0.08
    eight_bits: UnitInterval = 0.5
    no_geometry: UnitInterval = 0.5


NO_AUGMENTATION = Augmentation(mirror=0, permute=0, cast=0, exposure=0, noise=0, tone=0, eight_bits=0, no_geometry=1)


@dataclass(frozen=True)
class Batch:
    """Training images in the network's space.

    Attributes:
        condition: (N, K, H, W), what the network sees.
        target: (N, 3 C, H, W), what it is to predict.
        masks: (N, H, W), coverage.
        factor: (N,), the exposure that was applied, which decoding the specular component needs.
    """

    condition: Tensor
    target: Tensor
    masks: Tensor
    factor: Tensor


class TrainingImages:
    """All images of a folder of shards, on a device as half floats (115 kB an image of 64 x 64), and their ``seeds``."""

    def __init__(self, folder: Path, *, limit: int | None = None, device: torch.device = CPU) -> None:
        """Load the shards. Raises InputError for a folder without any, or with shards of different sizes."""
        loaded: list[dict[str, Tensor]] = []
        seeds: set[int] = set()
        count = 0
        for path in shard_paths(folder):
            tensors, info = load_shard(path)
            if loaded and tensors["image"].shape[1] != loaded[0]["image"].shape[1]:
                raise InputError(f"{path}: expected images of {loaded[0]['image'].shape[1]} pixels, found {info.size}")
            loaded.append(tensors)
            seeds.add(info.seed)
            count += info.count
            if limit is not None and count >= limit:
                break
        self.folder, self.seeds = folder, frozenset(seeds)
        self._tensors = {name: torch.cat([shard[name] for shard in loaded])[:limit].to(device) for name in CHANNELS}
        self.size = self._tensors["image"].shape[1]

    def __len__(self) -> int:
        return len(self._tensors["image"])

    def linear(self, index: Tensor) -> dict[str, Tensor]:
        """The images (N,) as they were rendered: tensors of ia_bench_training.shards, float32."""
        return {name: tensor[index.to(tensor.device)].float() for name, tensor in self._tensors.items()}

    def batch(self, index: Tensor, config: NetworkConfig, augmentation: Augmentation, generator: torch.Generator) -> Batch:
        """Encode images (N,), augmented by draws of ``generator``, which is of their device."""
        return encode(augment(self.linear(index), augmentation, generator), config, augmentation, generator)


def drawn_by(generator: torch.Generator) -> dict[str, Any]:
    """Arguments of torch's random functions: drawn by the ``generator``, on its device."""
    return {"generator": generator, "device": generator.device}


def reordered(values: Tensor, order: Tensor) -> Tensor:
    """Images (N, H, W, 3) with the channels of each in its ``order`` (N, 3)."""
    return torch.gather(values, 3, order[:, None, None].expand_as(values))


def augment(images: dict[str, Tensor], settings: Augmentation, generator: torch.Generator) -> dict[str, Tensor]:
    """Mirror, permute channels and colour the light of linear images; geometry and masks follow."""
    count, at = len(images["image"]), drawn_by(generator)
    radiance, masks = images["image"][..., :3], images["image"][..., 3:]
    mirrored = torch.rand(count, **at) < settings.mirror
    permuted = torch.rand(count, **at) < settings.permute
    order = torch.where(permuted[:, None], torch.rand(count, 3, **at).argsort(1), torch.arange(3, device=generator.device))
    gain = torch.exp(settings.cast * torch.randn(count, 3, **at))[:, None, None]
    sides = torch.tensor([-1.0, 1.0, 1.0], device=generator.device)

    changed = {
        "image": torch.cat([reordered(radiance, order) * gain, masks], -1),
        "albedo": reordered(images["albedo"], order),
        "specular": reordered(images["specular"], order) * gain,
        "normal": torch.where(mirrored[:, None, None, None], images["normal"] * sides, images["normal"]),
        "visibility": images["visibility"],
    }
    return {name: torch.where(mirrored[:, None, None, None], values.flip(2), values) for name, values in changed.items()}


def encode(images: dict[str, Tensor], config: NetworkConfig, settings: Augmentation, generator: torch.Generator) -> Batch:
    """Expose, add sensor noise, and encode linear images for a network of ``config``."""
    radiance, masks = images["image"][..., :3], images["image"][..., 3]
    count, at = len(masks), drawn_by(generator)
    factor = exposure(radiance, masks)
    factor = factor * torch.exp(settings.exposure * (2 * torch.rand(count, **at) - 1))
    deviation = settings.noise * torch.rand(count, **at) / factor
    grain = torch.randn(radiance.shape, **at) * deviation[:, None, None, None] * masks[..., None]
    condition = _developed(encode_image((radiance + grain).clamp_min(0), masks, factor), settings, at)
    withheld = torch.rand(count, **at) < settings.no_geometry
    if config.geometry:
        geometry = encode_geometry(images["normal"], images["visibility"])
        condition = torch.cat([condition, geometry * ~withheld[:, None, None, None]], 1)
    target = torch.cat([encoding.encode(name, images[name], masks, factor) for name in config.components], 1)
    return Batch(condition, target, masks, factor)


def _developed(condition: Tensor, settings: Augmentation, at: dict[str, Any]) -> Tensor:
    """What a camera's tone curve and its 8 bits make of encoded images (N, 4, H, W)."""
    count, shown = len(condition), (1 + condition[:, :3]) / 2
    exponent = torch.exp(settings.tone * torch.randn(count, 1, 1, 1, **at))
    coarse = torch.rand(count, 1, 1, 1, **at) < settings.eight_bits
    shown = shown.clamp_min(1e-6) ** exponent
    shown = torch.where(coarse, (255 * shown).round() / 255, shown)
    return torch.cat([torch.where(condition[:, 3:] > 0, 2 * shown - 1, condition[:, :3]), condition[:, 3:]], 1)
