"""The network p(albedo, specular | image): a ``diffusers`` UNet that sees the image by concatenation and cross-attention.

As in the original code (the paper's text names the second only), the image enters twice: beside the noisy components as
channels, and as tokens of an image encoder through cross-attention. The same module with a constant instead of noise is
the deterministic regressor: equal size, equal inputs.

The UNet works on folded pixels, where fine texture is costly to carry. A head finishes at full resolution: the albedo is the
image times a gain that it predicts, plus an offset. Where shading is smooth so is the gain, and the image's texture passes.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ia_bench.common.errors import InputError, unknown
from ia_bench.common.ranges import Number
from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench.priors.contract import COMPONENTS
from ia_bench.priors.diffusion.sampler import SCHEDULE_KEYS, Denoise, NoiseSchedule
from ia_bench.priors.weight_files import fill, read_description

import_torchvision()
from diffusers import UNet2DConditionModel  # noqa: E402 (before a run's clock starts, like torch)

Kind = Literal["diffusion", "regressor"]
IMAGE_CHANNELS = 4  # colour and mask
GEOMETRY_CHANNELS = 4  # normal and ambient visibility
FEATURES = 16  # per pixel, from the UNet to the head


@dataclass(frozen=True)
class NetworkConfig:
    """Everything that determines the network's shape and the meaning of its input and output.

    Attributes:
        kind: "diffusion", or "regressor", into which no noise goes and out of which the estimate comes.
        components: What it predicts. One network for both shares its trunk; one network for each is the paper's way.
        size: Native side in pixels.
        fold: Side of the pixel blocks that become channels before the first convolution.
        channels: Widths of the UNet's levels; the lowest level has cross-attention.
        layers: Residual blocks a level.
        head: Width of the convolutions at full resolution that end the network.
        geometry: Whether normals and visibility are inputs, which may be absent.
        encoder: "small", which is trained along. The paper's, CLIP, is a part of ``prior=intrinsicanything``.
        tokens: Width of a token.
        schedule: See :meth:`ia_bench.priors.diffusion.sampler.NoiseSchedule.from_diffusers`.

    Raises:
        InputError: The values make no network.
    """

    kind: Kind = "diffusion"
    components: tuple[str, ...] = ("albedo", "specular")
    size: Number = 64
    fold: Number = 4
    channels: tuple[int, ...] = (64, 96, 112)
    layers: Number = 1
    head: Number = 32
    geometry: bool = True
    encoder: Literal["small"] = "small"
    tokens: Number = 128
    schedule: dict[str, Any] = field(
        default_factory=lambda: {
            "num_train_timesteps": 1000,
            "beta_schedule": "squaredcos_cap_v2",
            "rescale_betas_zero_snr": True,
        }
    )

    def __post_init__(self) -> None:
        if not self.components or len({*self.components} & {*COMPONENTS}) < len(self.components):
            raise InputError(
                f"network.components: expected some of {', '.join(COMPONENTS)}, each once, found {list(self.components)}"
            )
        if not self.channels or any(width < 1 or width % 16 for width in self.channels):
            raise InputError(f"network.channels: expected multiples of 16, found {list(self.channels)}")
        stride = math.lcm(self.fold * 2 ** (len(self.channels) - 1), 4)
        if self.size % stride:
            raise InputError(f"network.size: expected a multiple of {stride} (fold x down-sampling, encoder), found {self.size}")
        if self.tokens % 16:
            raise InputError(f"network.tokens: expected a multiple of 16 for the small encoder, found {self.tokens}")
        for key in self.schedule:
            if key not in SCHEDULE_KEYS:
                raise InputError(unknown("key of network.schedule", key, SCHEDULE_KEYS))
        timesteps = self.schedule.get("num_train_timesteps")
        if not isinstance(timesteps, int) or timesteps < 1:
            raise InputError(f"network.schedule: num_train_timesteps: expected a whole number >= 1, found {timesteps!r}")

    @property
    def output_channels(self) -> int:
        """Channels of the components before folding."""
        return 3 * len(self.components)

    @property
    def timesteps(self) -> int:
        """Length of the schedule; at the last one a diffusion network sees only noise, and a regressor is always told that."""
        return int(self.schedule["num_train_timesteps"])

    @property
    def noise_schedule(self) -> NoiseSchedule:
        """The noise levels of a diffusion network."""
        return NoiseSchedule.from_diffusers(self.schedule)

    @property
    def condition_channels(self) -> int:
        """Channels of the condition before folding."""
        return IMAGE_CHANNELS + GEOMETRY_CHANNELS * self.geometry


class MaterialNetwork(nn.Module):
    """A diffusers ``UNet2DConditionModel`` on folded pixels, with a ``head`` and an image ``encoder``."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        block, levels = config.fold**2, len(config.channels)
        noisy = config.output_channels if config.kind == "diffusion" else 0
        self.unet = UNet2DConditionModel(
            sample_size=config.size // config.fold,
            in_channels=block * (noisy + config.condition_channels),
            out_channels=block * FEATURES,
            down_block_types=("DownBlock2D",) * (levels - 1) + ("CrossAttnDownBlock2D",),
            mid_block_type="UNetMidBlock2DCrossAttn",
            up_block_types=("CrossAttnUpBlock2D",) + ("UpBlock2D",) * (levels - 1),
            block_out_channels=config.channels,
            layers_per_block=config.layers,
            norm_num_groups=16,
            attention_head_dim=max(config.channels[-1] // 32, 1),
            cross_attention_dim=config.tokens,
            resnet_time_scale_shift="scale_shift",
        )
        self.head = DetailHead(config, noisy)
        self.encoder = SmallEncoder(config.tokens)

    def forward(self, noisy: Tensor | None, timestep: Tensor, condition: Tensor) -> Tensor:
        """The estimate (N, 3 C, H, W) of the clean components, from ``timestep`` (N,).

        ``noisy`` (N, 3 C, H, W) is None for a regressor; H and W are multiples of fold x down-sampling. ``condition``
        (N, condition_channels, H, W) has zero for geometry that is unknown.
        """
        return self.denoise(noisy, timestep, condition, self.tokens(condition))

    def tokens(self, condition: Tensor) -> Tensor:
        """What the image encoder makes of the condition, (N, tokens, width): once per image, not once per step."""
        tokens: Tensor = self.encoder(condition[:, :IMAGE_CHANNELS])
        return tokens

    def denoise(self, noisy: Tensor | None, timestep: Tensor, condition: Tensor, tokens: Tensor) -> Tensor:
        """Do what :meth:`forward` does, with the tokens at hand."""
        channels = condition if noisy is None else torch.cat([noisy, condition], 1)
        folded = F.pixel_unshuffle(channels, self.config.fold)
        output = F.pixel_shuffle(self.unet(folded, timestep, tokens, return_dict=False)[0], self.config.fold)
        estimate: Tensor = self.head(output, channels, condition)
        return estimate


class DetailHead(nn.Module):
    """Convolutions at full resolution, from the UNet's features and all that it saw to the components.

    Albedo, in display values: image (1 + gain) + offset; specular shading: the offset alone. Both start at zero, so the
    image itself is the first guess of the albedo.
    """

    def __init__(self, config: NetworkConfig, noisy: int) -> None:
        super().__init__()
        self.config = config
        self.enter = nn.Conv2d(FEATURES + noisy + config.condition_channels, config.head, 3, padding=1)
        self.middle = nn.ModuleList([nn.Conv2d(config.head, config.head, 3, padding=1) for _ in range(2)])
        self.leave = nn.Conv2d(config.head, config.output_channels + 3 * ("albedo" in config.components), 1)
        for parameter in self.leave.parameters():
            nn.init.zeros_(parameter)

    def forward(self, features: Tensor, channels: Tensor, condition: Tensor) -> Tensor:
        """(N, 3 C, H, W) of ``features`` (N, FEATURES, H, W), the UNet's input ``channels``, and the condition among them."""
        hidden = F.silu(self.enter(torch.cat([features, channels], 1)))
        for layer in self.middle:
            hidden = hidden + F.silu(layer(hidden))
        output: Tensor = self.leave(hidden)
        components = self.config.components
        if "albedo" not in components:
            return output
        offsets, gain = output[:, :-3], output[:, -3:]
        scaled = (1 + condition[:, :3]) * (1 + gain) - 1
        return offsets + torch.cat([scaled if name == "albedo" else torch.zeros_like(gain) for name in components], 1)


class SmallEncoder(nn.Module):
    """A convolutional encoder, trained with the network: (N, 4, H, W) -> 8 x 8 tokens with their positions."""

    SIDE = 8

    def __init__(self, width: int) -> None:
        super().__init__()
        layers: list[nn.Module] = [nn.PixelUnshuffle(4), nn.Conv2d(16 * IMAGE_CHANNELS, 48, 3, padding=1)]
        for inside, outside, stride in ((48, 96, 2), (96, width, 1)):
            layers += [nn.GroupNorm(16, inside), nn.SiLU(), nn.Conv2d(inside, outside, 3, padding=1, stride=stride)]
        self.convolutions = nn.Sequential(*layers)
        self.position = nn.Parameter(torch.zeros(1, self.SIDE**2, width))
        self.norm = nn.LayerNorm(width)

    def forward(self, image: Tensor) -> Tensor:
        """Tokens (N, 64, width) of images of any size that is a multiple of 4."""
        features = F.adaptive_avg_pool2d(self.convolutions(image), self.SIDE)
        return self.norm(features.flatten(2).transpose(1, 2) + self.position)


class Conditioned:
    """``network`` asked about a batch of conditions, ``chunk`` images per pass, which bounds memory.

    ``cost`` counts its evaluations, one per image and pass, as "network_calls".
    """

    def __init__(self, network: MaterialNetwork, *, chunk: int = 64, bf16: bool = False, cost: Counter[str] | None = None) -> None:
        self.network, self.chunk, self.bf16 = network, chunk, bf16
        self.cost: Counter[str] = Counter() if cost is None else cost

    def bind(self, condition: Tensor) -> Denoise:
        """The denoiser of (N, condition_channels, H, W) images; their tokens are computed here, once.

        It may be called with any whole multiple k of N noisy images: image i is explained by condition i mod N, so that
        several samples of one image share the encoder's work.
        """
        tokens = self._tokens(condition)
        return lambda noisy, t: self._output(noisy, len(noisy), t, condition, tokens)

    def regress(self, condition: Tensor) -> Tensor:
        """The regressor's estimate (N, 3 C, H, W)."""
        return self._output(None, len(condition), self.network.config.timesteps - 1, condition, self._tokens(condition))

    def _tokens(self, condition: Tensor) -> Tensor:
        with torch.no_grad(), self._precision():
            return torch.cat([self.network.tokens(part).float() for part in condition.split(self.chunk)])

    def _output(self, noisy: Tensor | None, count: int, t: int, condition: Tensor, tokens: Tensor) -> Tensor:
        parts = []
        for part in torch.arange(count, device=condition.device).split(self.chunk):
            timestep, image = torch.full((len(part),), t, device=condition.device), part % len(condition)
            seen = None if noisy is None else noisy[part]
            with self._precision():
                parts.append(self.network.denoise(seen, timestep, condition[image], tokens[image]).float())
        self.cost["network_calls"] += count
        return torch.cat(parts)

    def _precision(self) -> torch.autocast:
        return torch.autocast(next(self.network.parameters()).device.type, torch.bfloat16, enabled=self.bf16)


# ---- on disk: a folder of files that the ``diffusers`` ecosystem reads ------------------------------------------------

DESCRIPTION = "prior.json"  # the network's config, and where the weights come from
FILES = {
    "unet/diffusion_pytorch_model.safetensors": "unet",  # beside its config, as diffusers writes it
    "head.safetensors": "head",
    "encoder.safetensors": "encoder",
}
"""The parts of a network, by the file that holds them; the noise schedule is in ``scheduler/scheduler_config.json``."""


def load_network(folder: Path) -> tuple[MaterialNetwork, dict[str, Any]]:
    """Load the network in ``folder``, in float32 and evaluation mode, and its provenance.

    Raises InputError, naming file and key, for what is missing, damaged or does not fit its config.
    """
    config, provenance = read_description(folder / DESCRIPTION, NetworkConfig)
    network = MaterialNetwork(config)
    for name, module in modules_of(network).items():
        fill(module, folder / name)
    return network.eval().requires_grad_(False), provenance


def modules_of(network: MaterialNetwork) -> dict[str, nn.Module]:
    """The parts of a network by the file that holds each."""
    return {name: getattr(network, part) for name, part in FILES.items()}
