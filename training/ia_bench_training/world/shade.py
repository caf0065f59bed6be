"""Images of traced views, each in materials and a light of its own, in plain torch on any device.

Image = diffuse + specular + what the object throws onto itself. The diffuse part sums the light of DIRECTIONS with exact
shadows. The specular part is split (Karis 2013): filtered light, times what the coat reflects, times the share of the
lobe that is free. Light between parts of the object is taken from the picture: hidden directions show what is beside them in it.
The judge's images come from the benchmark's renderer, so what is approximate here cannot flatter.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ia_bench.light.latlong import direction_to_texel, row_solid_angles, texel_centres
from ia_bench.material.brdf import F0, dot, normalize
from ia_bench_training.dataset import drawn_by
from ia_bench_training.lights import HEIGHT, WIDTH
from ia_bench_training.world.layout import DIRECTIONS, LOBES, Bank, directions

SLOTS = 6  # materials of an object at most
WARM = (0.8, 0.0, -0.8)
WARMTHS, WARMTH_SHARES = (0.05, 0.2, 0.6), (0.4, 0.3, 0.3)
"""Casts of lights: spreads along the axis from cool to warm, on which nine tenths of those of photographed lights lie, and how
frequent each is; the widest is for lamps and sunsets, which are warm alone and which photographs of lights hold too seldom."""
LOBE, SHARP = 8, 64.0  # directions of a smooth lobe, and the power of their cosine by which each counts for what is free of it


class Dice:
    """Random tensors of one generator, on its device."""

    def __init__(self, generator: torch.Generator) -> None:
        self._generator, self._at = generator, drawn_by(generator)

    def uniform(self, low: float, high: float, *shape: int) -> Tensor:
        """Uniform between ``low`` and ``high``."""
        return low + (high - low) * torch.rand(*shape, **self._at)

    def normal(self, spread: float, *shape: int) -> Tensor:
        """Normal about 0."""
        return spread * torch.randn(*shape, **self._at)

    def chance(self, share: float, *shape: int) -> Tensor:
        """True with this probability."""
        return torch.rand(*shape, **self._at) < share

    def integers(self, low: int, high: int, *shape: int) -> Tensor:
        """Whole numbers, ``low`` <= n < ``high``."""
        drawn = (low + (high - low) * torch.rand(*shape, **self._at)).long()
        return drawn.clamp(max=high - 1)  # of 2^24 sums some three are rounded up to ``high``

    def weighted(self, chances: Tensor, count: int) -> Tensor:
        """``count`` numbers below len(chances)."""
        return torch.multinomial(chances, count, replacement=True, generator=self._generator)


# ---------------------------------------------------------------- materials
def draw_materials(dice: Dice, images: int, tiles: Bank, chances: Tensor, palettes: Tensor, share: float) -> dict[str, Tensor]:
    """Materials of ``images`` x SLOTS slots, M of them: tensors (M, ...) by name.

    ``chances``: of the real textures, which come first among the ``tiles``. A material is a texture as it is (``kind`` 0), its
    pattern in another colour (1) or in two (2), or nearly plain (3), and at times has a print on it. ``polish`` is of real meshes.
    """
    count, real = images * SLOTS, len(chances)
    which = dice.integers(real, len(tiles.mean), count)
    printed = dice.integers(real, len(tiles.mean), count)
    if real and share:
        which = torch.where(dice.chance(share, count), dice.weighted(chances, count), which)
    turn = dice.uniform(0, 6.2832, count)
    scale = torch.exp(dice.uniform(-1.6, 0.5, count))
    mean = tiles.mean[which]
    colours = palettes[dice.integers(0, len(palettes), images)].repeat_interleave(SLOTS, 0)  # one palette an object
    order = dice.uniform(0, 1, count, colours.shape[1]).argsort(1)[:, :3]
    band = torch.stack([dice.uniform(0.05, 0.3, count), dice.uniform(0.3, 0.6, count), dice.uniform(0.6, 1, count)], -1)
    free = band.gather(1, dice.weighted(chances.new_tensor([0.25, 0.45, 0.3]), count)[:, None])[:, 0]
    own = mean[:, 3] + dice.normal(0.1, count)
    kind = dice.weighted(chances.new_tensor([0.4, 0.3, 0.15, 0.15]), count)
    metal = torch.where(mean[:, 4] > 0.5, dice.chance(0.7, count), dice.chance(0.04, count))
    return {
        "which": which,
        "printed": printed,
        "print": dice.chance(0.3, count),
        "frame": scale[:, None] * torch.stack([turn.cos(), turn.sin(), -turn.sin(), turn.cos()], -1),
        "shift": dice.uniform(0, 2, count, 2),
        "scale": scale,
        "kind": kind,
        "gain": torch.exp(dice.normal(0.25, count, 1) + dice.normal(0.1, count, 3)),
        "contrast": torch.where(kind == 3, 0.15, dice.uniform(0.3, 1.3, count)),
        "steep": dice.uniform(2, 20, count),
        "colours": colours.gather(1, order[..., None].expand(-1, -1, 3)),
        "level": mean[:, :3].mean(-1).clamp_min(0.02),
        "print_level": tiles.mean[printed, :3].mean(-1),
        "rough": torch.where(dice.chance(0.4, count), free, own) - mean[:, 3],
        "wear": dice.normal(0.12, count),
        "polish": dice.normal(0.22, count) - 0.18,
        "metal": metal.float(),
    }


def surface(points: Tensor, slot: Tensor, spread: Tensor, base: Tensor, drawn: dict[str, Tensor], tiles: Bank) -> Tensor:
    """Albedo, roughness and metallic (..., 5) at texture coordinates ``points`` (..., 2), ``spread`` (...) of them wide.

    ``slot`` (...) and ``base`` (..., broadcast), the first material of the image, say which of the ``drawn`` materials it is.
    """
    m = base + slot.clamp(max=SLOTS - 1)
    a, b, c, d = drawn["frame"][m].unbind(-1)
    x, y = points.unbind(-1)
    place, wide = torch.stack([a * x + b * y, c * x + d * y], -1) + drawn["shift"][m], spread * drawn["scale"][m]
    found = tiles.look_up(drawn["which"][m], place, wide)
    ratio = (found[..., :3].mean(-1) / drawn["level"][m]).clamp(0.02, 4)
    first, second, third = drawn["colours"][m].unbind(-2)
    kind = drawn["kind"][m][..., None]
    mixed = first + torch.sigmoid(drawn["steep"][m] * (ratio - 1))[..., None] * (second - first)
    albedo = torch.where(kind == 0, found[..., :3] * drawn["gain"][m], first * (ratio ** drawn["contrast"][m])[..., None])
    albedo = torch.where(kind == 2, mixed, albedo)
    over = tiles.look_up(drawn["printed"][m], place, wide)[..., :3].mean(-1)
    cover = torch.sigmoid(30 * (over - drawn["print_level"][m])) * drawn["print"][m]
    albedo = albedo + cover[..., None] * (third - albedo)
    rough = found[..., 3] + drawn["rough"][m] + drawn["wear"][m] * (ratio - 1)
    return torch.cat([albedo, rough[..., None], drawn["metal"][m][..., None]], -1)


# ---------------------------------------------------------------- lights
def draw_lights(dice: Dice, images: int, bank: Tensor, real: int, share: float) -> Tensor:
    """A light for each of the images: one of the bank, or two mixed, each turned and tinted: (N, 3, len(LOBES), H, W) float32."""
    count = 2 * images
    which = dice.integers(real, len(bank), count)
    if real and share:
        which = torch.where(dice.chance(share, count), dice.integers(0, real, count), which)
    part = dice.uniform(0.3, 0.7, images) * dice.chance(0.3, images)
    spreads, shares, axis = (bank.new_tensor(each, dtype=torch.float32) for each in (WARMTHS, WARMTH_SHARES, WARM))
    spread = spreads[dice.weighted(shares, count)]
    cast = dice.normal(1, count) * spread
    warmth = torch.where(spread == spreads[-1], cast.abs(), cast)[:, None] * axis
    tint = (warmth + dice.normal(0.03, count, 3)).exp() * torch.stack([1 - part, part], -1).reshape(-1, 1)
    turn, picked, second, mixed = dice.integers(0, WIDTH, count).tolist(), which.tolist(), part.tolist(), []
    for image in range(images):
        total = torch.zeros((), device=bank.device)
        for k in (2 * image, 2 * image + 1) if second[image] else (2 * image,):
            total = total + torch.roll(bank[picked[k]].float(), turn[k], -1) * tint[k][:, None, None, None]
        mixed.append(total)
    return torch.stack(mixed)


class Shader:
    """What shading needs of the directions and of the maps' texels, on a device."""

    def __init__(self, device: torch.device) -> None:
        around = texel_centres(HEIGHT, WIDTH).reshape(-1, 3)
        self.directions = directions().to(device)
        self._nearest = (around @ directions().T).argmax(1).to(device)
        self._area = row_solid_angles(HEIGHT, WIDTH).float().repeat_interleave(WIDTH).to(device)
        self._bits = ((torch.arange(256)[:, None] >> torch.arange(8)) & 1).float().to(device)  # of every byte
        cosine, beside = (around @ directions().T).topk(LOBE, dim=1)
        self._beside, self._weight = beside.to(device), F.normalize(cosine**SHARP, p=1, dim=1).to(device)

    def __call__(
        self, lights: Tensor, normal: Tensor, toward: Tensor, sky: Tensor, albedo: Tensor, roughness: Tensor, metallic: Tensor
    ) -> tuple[Tensor, ...]:
        """Light on P pixels of each of N images.

        Args:
            lights: (N, 3, len(LOBES), H, W).
            normal: (N, P, 3), unit.
            toward: (N, P, 3), unit, to the camera.
            sky: (N, P, DIRECTIONS / 8) uint8.
            albedo: (N, P, 3).
            roughness: (N, P, 1), perceptual.
            metallic: (N, P, 1).

        Returns:
            Irradiance over pi and specular radiance, both direct; what is mirrored of the object's own radiance; (N, P, 3) each.
            The ambient visibility, and what the coat leaves of the diffuse part, (N, P, 1) each.
        """
        images = len(lights)
        power = lights[:, :, 0].flatten(2) * self._area
        coming = torch.zeros(images, 3, DIRECTIONS, device=power.device).index_add_(2, self._nearest, power)
        free = F.embedding(sky.int(), self._bits).flatten(-2)
        cosine = (normal @ self.directions.T).clamp_min_(0).mul_(free)
        even = coming.new_full((images, 1, DIRECTIONS), 4 / DIRECTIONS * torch.pi)
        irradiance, ambient = (cosine @ torch.cat([coming, even], 1).movedim(1, -1) / torch.pi).split([3, 1], -1)
        ambient = ambient.clamp(0, 1)

        facing = dot(normal, toward).clamp(1e-3, 1)
        mirror = normalize(2 * facing * normal - toward)
        texel = direction_to_texel(mirror, HEIGHT, WIDTH)
        lobe = (free.gather(-1, self._beside[texel]) * self._weight[texel]).sum(-1, keepdim=True)
        lobe = lobe + roughness.square() * (ambient - lobe)
        level = torch.searchsorted(roughness.new_tensor(LOBES), roughness.contiguous()).clamp(1, len(LOBES) - 1)
        edges = roughness.new_tensor(LOBES)
        depth = level - 1 + ((roughness - edges[level - 1]) / (edges[level] - edges[level - 1])).clamp(0, 1)
        column = (torch.pi - torch.atan2(mirror[..., 1:2], mirror[..., :1])) / torch.pi - 1
        row = torch.acos(mirror[..., 2:].clamp(-1, 1)) * (2 / torch.pi) - 1
        place = torch.cat([column, row, depth * (2 / (len(LOBES) - 1)) - 1], -1)
        # align_corners has -1 at the middle of the first texel; columns wrap, so one is added on each side
        padded = F.pad(lights.flatten(1, 2), (1, 1, 0, 0), mode="circular").unflatten(1, (3, len(LOBES)))
        scale = place.new_tensor([WIDTH / (WIDTH + 1), HEIGHT / (HEIGHT - 1), 1.0])
        met = F.grid_sample(padded, (place * scale)[:, None, None], align_corners=True, padding_mode="border")[:, :, 0, 0].movedim(
            1, -1
        )
        weight, bias = _coat(roughness, facing)
        reflectance = (F0 + metallic * (albedo - F0)) * weight + bias
        return irradiance, met * lobe * reflectance, (1 - lobe) * reflectance, ambient, 1 - F0 * weight - bias


def _coat(roughness: Tensor, facing: Tensor) -> tuple[Tensor, Tensor]:
    """What the coat reflects of even light is the first times its reflectance plus the second (Karis 2014)."""
    rest = 1 - roughness
    grazing = torch.minimum(rest * rest, torch.exp2(-9.28 * facing)) * rest + 0.0425 - 0.0275 * roughness
    return 1.04 - 0.572 * roughness - 1.04 * grazing, 1.04 * grazing + 0.022 * roughness - 0.04
