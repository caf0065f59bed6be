"""A folder of :mod:`ia_bench_training.world.make` as training images: every time an image is asked for it is another one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors.torch import load_file
from torch import Tensor
from torch.nn import functional as F

from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json
from ia_bench.common.ranges import UnitInterval
from ia_bench.priors.diffusion.network import NetworkConfig
from ia_bench_training.dataset import CPU, Augmentation, Batch, augment, encode
from ia_bench_training.palettes import MAX_ALBEDO, MIN_ALBEDO
from ia_bench_training.world.layout import ATLAS, ATLAS_LEVELS, BANKS, KINDS, LEVELS, MISS, TILE, WORLD, Bank, filtered
from ia_bench_training.world.shade import SLOTS, Dice, Shader, draw_lights, draw_materials, surface

REACH = 6  # pixels from which hidden directions take their light
RADIANCE = 0.3  # the mean of an image
PIXELS = {"cpu": 1, "cuda": 64}  # images that are shaded together
SEAM = 0.1  # of texture coordinates between neighbouring points; what is more is another chart


@dataclass(frozen=True)
class Mixture:
    """Which share of what a world holds is real.

    Attributes:
        textures: Probability that a material wears a real texture.
        lights: Probability that a light is a photograph.
        meshes: Share of real meshes among the images.
    """

    textures: UnitInterval = 0.6
    lights: UnitInterval = 0.6
    meshes: UnitInterval = 0.4


class WorldImages:
    """Endless images on a device; ``index`` says which view each shows, its materials and light are drawn. See Batch of dataset."""

    def __init__(self, folder: Path, mixture: Mixture, device: torch.device = CPU) -> None:
        """Load what there is of a world so far. Raises InputError where there is none."""
        if not (folder / WORLD).is_file() or not (folder / BANKS).is_file():
            raise InputError(f"{folder}: expected {WORLD} and {BANKS} (python -m ia_bench_training.world.make makes them)")
        described = read_json(folder / WORLD)
        self.folder, self.size, self.seeds = folder, int(described["size"]), frozenset({int(described["seed"])})
        self.device, self.mixture = device, mixture
        kinds = [sorted(folder.glob(f"views_{kind}_*.safetensors")) for kind in KINDS]
        if not kinds[0]:
            raise InputError(f"{folder}: expected views_{KINDS[0]}_*.safetensors, found none yet")
        parts = [load_file(path) for path in [*kinds[0], *kinds[1]]]
        counts = [part["start"].diff() for part in parts]
        per_view = ("start", "atlas", "camera")
        self._pixels = {name: torch.cat([part[name] for part in parts]).to(device) for name in parts[0] if name not in per_view}
        self._views = {name: torch.cat([part[name] for part in parts]).to(device) for name in ("atlas", "camera")}
        ends = torch.cat([torch.zeros(1, dtype=torch.long), torch.cat(counts).cumsum(0)])
        self._start, self._count = ends[:-1].to(device), torch.cat(counts).to(device)
        self._procedural = sum(len(count) for count in counts[: len(kinds[0])])
        bank = load_file(folder / BANKS)
        if bank["lights"].shape[2] == 1:  # a world that has travelled
            bank["lights"] = filtered(bank["lights"][:, :, 0].movedim(1, -1))
        halved = int(described.get("halved", 0))
        self._tiles, self._atlases = (
            Bank({part: bank[f"{name}.{part}"] for part in ("flat", "mean")}, side >> halved, levels - halved, device)
            for name, side, levels in (("tiles", TILE, LEVELS), ("atlases", ATLAS, ATLAS_LEVELS))
        )
        self._chances, self._palettes, self._lights = (bank[name].to(device) for name in ("chances", "palettes", "lights"))
        self._real_lights, self._shade = int(bank["real"][1]), Shader(device)

    def __len__(self) -> int:
        """Views there are; an epoch shows as many, and each of both kinds as often as the mixture says."""
        return len(self._start)

    def batch(self, index: Tensor, config: NetworkConfig, augmentation: Augmentation, generator: torch.Generator) -> Batch:
        """Draw and encode as many images as ``index`` (N,) has numbers."""
        return encode(augment(self.linear(index, generator), augmentation, generator), config, augmentation, generator)

    @torch.no_grad()
    def linear(self, index: Tensor, generator: torch.Generator) -> dict[str, Tensor]:
        """New images of the views (N,): tensors of ia_bench_training.shards, and ``roughness``, ``metallic`` and ``material``.

        Of views of the wrong kind for the mixture another is taken. ``material`` (N, S, S, 1) is 0 outside, then 1 + the slot.
        """
        dice, images = Dice(generator), len(index)
        view = self._chosen(dice, index.to(self.device))
        drawn = draw_materials(dice, images, self._tiles, self._chances, self._palettes, self.mixture.textures)
        lights = draw_lights(dice, images, self._lights, self._real_lights, self.mixture.lights)
        step = PIXELS[self.device.type]
        parts = [self._shaded(view[k : k + step], k, drawn, lights[k : k + step]) for k in range(0, images, step)]
        return {name: torch.cat([part[name] for part in parts]) for name in parts[0]}

    def _chosen(self, dice: Dice, index: Tensor) -> Tensor:
        count, real = len(index), len(self) - self._procedural
        if not real or not self.mixture.meshes:
            return index % self._procedural
        other = self._procedural + index % real
        return torch.where(dice.chance(self.mixture.meshes, count), other, index % self._procedural)

    def _shaded(self, view: Tensor, first: int, drawn: dict[str, Tensor], lights: Tensor) -> dict[str, Tensor]:
        """Images of the views (N,), of which the first is number ``first`` of the batch."""
        images, size = len(view), self.size
        count = self._count[view]
        number = torch.arange(int(count.max()), device=self.device)
        valid = number < count[:, None]
        at = self._start[view][:, None] + torch.where(valid, number, 0)
        pixels = {name: values[at] for name, values in self._pixels.items()}
        uv, slot = pixels["uv"].float(), pixels["slot"].long()
        hit = (slot != MISS) & valid[..., None]
        across, down = (uv[..., k, :] - uv[..., 0, :] for k in (1, 2))
        spread = torch.minimum(across.norm(dim=-1), down.norm(dim=-1)).clamp(1e-4, SEAM)[..., None].expand(slot.shape)
        base = SLOTS * (first + torch.arange(images, device=self.device))[:, None, None]
        atlas = self._views["atlas"][view]
        worn = atlas >= 0
        found = spread.new_zeros(()) if bool(worn.all()) else surface(uv, slot, spread, base, drawn, self._tiles)
        if bool(worn.any()):
            found = torch.where(worn[:, None, None, None], self._worn(atlas, uv, spread, base, drawn), found)
        weight = hit.float()[..., None]
        coverage = weight.mean(-2)
        mean = (found * weight).sum(-2) / weight.sum(-2).clamp_min(1)
        albedo, roughness, metallic = mean[..., :3].clamp(MIN_ALBEDO, MAX_ALBEDO), mean[..., 3:4].clamp(0.05, 1), mean[..., 4:]
        normal, toward = (F.normalize(pixels[name].float(), dim=-1) for name in ("normal", "toward"))
        material = albedo, roughness, metallic
        irradiance, specular, mirrored, ambient, left = self._shade(lights, normal, toward, pixels["sky"], *material)
        paint = albedo * (1 - metallic) * left
        seen = normal @ self._views["camera"][view]
        number = 1 + torch.where(hit, slot, SLOTS).amin(-1, keepdim=True).float()
        own = paint * (1 - ambient) + mirrored
        columns = torch.cat([irradiance * paint, own, specular, albedo, seen, ambient, roughness, metallic], -1)
        columns = torch.cat([columns * coverage, coverage, number * (coverage > 0)], -1) * valid[..., None]
        flat = torch.zeros(images, size * size, columns.shape[-1], device=self.device)
        flat.scatter_add_(1, pixels["pixel"].long()[..., None].expand_as(columns), columns)
        dense = flat.unflatten(1, (size, size))
        parts = dense.split([3, 3, 3, 3, 3, 1, 1, 1, 1, 1], -1)
        diffuse, own, specular, albedo, seen, ambient, roughness, metallic, coverage, slots = parts
        beside = _blurred(torch.cat([diffuse + specular, coverage], -1))
        beside = beside[..., :3] / beside[..., 3:].clamp_min(1e-3)  # own is premultiplied already
        image = diffuse + specular + own * beside
        level = image.mean(-1).sum((1, 2)) / coverage.sum((1, 2, 3)).clamp_min(1e-6)
        scale = (RADIANCE / level.clamp_min(1e-8))[:, None, None, None]
        return {
            "image": torch.cat([scale * image, coverage], -1), "albedo": albedo, "specular": scale * specular, "normal": seen,
            "visibility": ambient, "roughness": roughness, "metallic": metallic, "material": slots,
        }  # fmt: skip

    def _worn(self, atlas: Tensor, uv: Tensor, spread: Tensor, base: Tensor, drawn: dict[str, Tensor]) -> Tensor:
        """Real meshes in their own textures; where they have no roughness, it is that of the material that was drawn."""
        place = torch.stack([uv[..., 0], 1 - uv[..., 1]], -1) + 1  # in (1, 2) nothing is mirrored
        found = self._atlases.look_up(atlas.clamp_min(0)[:, None, None].expand(spread.shape), place, spread)
        first = base[..., 0].squeeze(-1)
        polish = drawn["polish"][first][:, None, None, None]  # maps of roughness are matter than things are
        own = (found[..., 3:4] + polish).clamp(0.05, 1)
        known = self._atlases.mean[atlas.clamp_min(0), 3:4][:, None, None] > 0
        rough = torch.where(known, own, (drawn["rough"] + self._tiles.mean[drawn["which"], 3])[first][:, None, None, None])
        gain = drawn["gain"][first][:, None, None].sqrt()
        return torch.cat([found[..., :3] * gain, rough, found[..., 4:]], -1)


def _blurred(images: Tensor) -> Tensor:
    """Means over (2 REACH + 1)^2 pixels of (N, H, W, C), with black beyond the edges."""
    down = F.avg_pool2d(images.movedim(-1, 1), (2 * REACH + 1, 1), 1, (REACH, 0))
    return F.avg_pool2d(down, (1, 2 * REACH + 1), 1, (0, REACH)).movedim(1, -1)
