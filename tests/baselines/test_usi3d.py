"""USI3D: normalisations against their definitions, unpaired data, the losses' zeros, training, and the prior."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from ia_bench.common.errors import InputError
from ia_bench_baselines.usi3d.data import UnpairedImages
from ia_bench_baselines.usi3d.losses import discriminator_loss, physical_error, picture_error
from ia_bench_baselines.usi3d.networks import (
    Discriminator,
    instance_normalised,
)
from ia_bench_training.shards import ShardInfo, write_shard


def test_instance_norm_is_torchs_and_forgets_gain_and_offset():
    features = torch.randn(2, 5, 9, 7, generator=torch.Generator().manual_seed(0))
    found = instance_normalised(features)
    torch.testing.assert_close(found, torch.nn.functional.instance_norm(features))
    torch.testing.assert_close(found, instance_normalised(3 * features - 2), rtol=1e-4, atol=1e-4)


def write_images(folder: Path, count: int) -> Path:
    """Discs of random paints under a slope of light, with a little gloss everywhere."""
    rows, columns = torch.meshgrid(torch.linspace(1, -1, 64), torch.linspace(-1, 1, 64), indexing="ij")
    mask = (rows.square() + columns.square() < 0.8)[None, ..., None].float().expand(count, -1, -1, -1)
    albedo = 0.2 + 0.6 * torch.rand(count, 8, 8, 3, generator=torch.Generator().manual_seed(7))
    albedo = albedo.repeat_interleave(8, 1).repeat_interleave(8, 2)
    light = (0.6 + 0.3 * rows + 0.2 * columns)[None, ..., None]
    specular = torch.full((count, 64, 64, 3), 0.05)
    images = {
        "image": torch.cat([(albedo * light + specular) * mask, mask], -1),
        "albedo": albedo * mask,
        "specular": specular * mask,
        "normal": mask.expand(-1, -1, -1, 3),
        "visibility": mask,
    }
    folder.mkdir()
    halves = {name: value.half() for name, value in images.items()}
    write_shard(folder / "shard_00000.safetensors", halves, ShardInfo(seed=0, first=0, count=count, size=64))
    return folder


def test_the_domains_have_no_object_in_common(tmp_path: Path):
    """Eight images in a row show one object: ranges are whole eights, and those that are validated are not trained."""
    images = UnpairedImages(write_images(tmp_path / "data", 80), held_out=4)
    ranges = [*images._ranges.values(), images._held_out]
    numbers = [number for one in ranges for number in one]
    assert len(numbers) == len(set(numbers)) == 72
    objects = [{number // 8 for number in one} for one in images._ranges.values()]
    assert not (objects[0] & objects[1])
    assert not (objects[1] & objects[2])
    assert not (objects[0] & objects[2])
    with pytest.raises(InputError, match="expected more than"):
        UnpairedImages(tmp_path / "data", held_out=24)


def test_losses_are_zero_where_they_should_be():
    mask = (torch.rand(2, 1, 8, 8) > 0.4).float()
    albedo, shading = (torch.cat([2 * torch.rand(2, 3, 8, 8) - 1, mask], 1) for _ in range(2))
    product = (0.5 + 0.5 * albedo[:, :3]) * (0.5 + 0.5 * shading[:, :3])
    image = torch.cat([2 * product - 1 + 3 * (1 - mask), mask], 1)
    assert float(physical_error(image, albedo, shading)) < 1e-6
    assert float(picture_error(torch.cat([image[:, :3] + 5 * (1 - mask), mask], 1), image)) < 1e-6
    judge = Discriminator()
    with torch.no_grad():
        judge.last.weight.zero_()
        judge.last.bias.fill_(1.0)
    picture = torch.rand(2, 4, 64, 64)
    assert float(discriminator_loss(judge, picture, (picture,)).detach()) == pytest.approx(1)  # true ones right, made ones wrong
