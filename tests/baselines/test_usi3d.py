"""USI3D: normalisations against their definitions, unpaired data, the losses' zeros, training, and the prior."""

from pathlib import Path

import pytest
import torch
from training.test_dataset import shard

from ia_bench.common.errors import InputError
from ia_bench_baselines.usi3d.data import UnpairedImages
from ia_bench_baselines.usi3d.losses import discriminator_loss, physical_error, picture_error
from ia_bench_baselines.usi3d.networks import Discriminator
from ia_bench_training.shards import ShardInfo, write_shard


def test_the_domains_have_no_object_in_common(tmp_path: Path):
    """Eight images in a row show one object: ranges are whole eights, and those that are validated are not trained."""
    write_shard(tmp_path / "shard_00000.safetensors", shard(80, 64), ShardInfo(0, 0, 80, 64))
    images = UnpairedImages(tmp_path, held_out=4)
    ranges = [*images._ranges.values(), images._held_out]
    numbers = [number for one in ranges for number in one]
    assert len(numbers) == len(set(numbers)) == 72
    objects = [{number // 8 for number in one} for one in images._ranges.values()]
    assert not (objects[0] & objects[1])
    assert not (objects[1] & objects[2])
    assert not (objects[0] & objects[2])
    with pytest.raises(InputError, match="expected at least 96 images of 64 pixels, found 80 of 64"):
        UnpairedImages(tmp_path, held_out=24)


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
