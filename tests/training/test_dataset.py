import pytest
import torch

from ia_bench.priors.diffusion.network import NetworkConfig
from ia_bench_training.dataset import NO_AUGMENTATION, Augmentation, TrainingImages, augment
from ia_bench_training.shards import CHANNELS, ShardInfo, load_shard, shard_path, shard_paths, write_shard


def shard(count=6, size=16, seed=0):
    generator = torch.Generator().manual_seed(seed)
    masks = torch.zeros(count, size, size, 1)
    masks[:, 3:-2, 2:-4] = 1
    albedo = torch.rand(count, size, size, 3, generator=generator)
    shading = torch.rand(count, size, size, 1, generator=generator)
    specular = 0.1 * torch.rand(count, size, size, 3, generator=generator)
    normal = torch.randn(count, size, size, 3, generator=generator)
    return {
        "image": torch.cat([(albedo * shading + specular) * masks, masks], -1),
        "albedo": albedo * masks,
        "specular": specular * masks,
        "normal": normal / normal.norm(dim=-1, keepdim=True) * masks,
        "visibility": shading * masks,
    }


@pytest.fixture
def folder(tmp_path):
    for number in range(2):
        write_shard(shard_path(tmp_path, number), shard(seed=number), ShardInfo(0, 6 * number, 6, 16))
    return tmp_path


def test_recolouring_the_light_leaves_the_albedo_and_the_shading_equation_as_they_are():
    images = shard()
    changed = augment(images, Augmentation(mirror=0, permute=0, cast=0.5), torch.Generator().manual_seed(1))
    torch.testing.assert_close(changed["albedo"], images["albedo"])
    gain = changed["image"][..., :3].sum((1, 2)) / images["image"][..., :3].sum((1, 2))
    assert gain.std() > 0.1
    torch.testing.assert_close(changed["image"][..., :3], images["image"][..., :3] * gain[:, None, None])
    torch.testing.assert_close(changed["specular"], images["specular"] * gain[:, None, None])


def test_permuted_channels_stay_together():
    images = shard()
    changed = augment(images, Augmentation(mirror=0, permute=1, cast=0), torch.Generator().manual_seed(3))
    for n in range(6):
        orders = [
            order
            for order in torch.cartesian_prod(*[torch.arange(3)] * 3)
            if torch.equal(changed["albedo"][n], images["albedo"][n][..., order])
        ]
        assert len(orders) == 1
        assert torch.equal(changed["image"][n, ..., :3], images["image"][n, ..., orders[0]])
        assert torch.equal(changed["specular"][n], images["specular"][n][..., orders[0]])


def test_a_mirrored_image_has_mirrored_normals():
    images = shard()
    changed = augment(images, Augmentation(mirror=1, permute=0, cast=0), torch.Generator())
    torch.testing.assert_close(changed["image"], images["image"].flip(2))
    torch.testing.assert_close(changed["normal"], images["normal"].flip(2) * torch.tensor([-1.0, 1, 1]))


def test_geometry_is_withheld_as_often_as_asked(folder):
    images, config = TrainingImages(folder), NetworkConfig(size=16, channels=(16, 32))
    assert len(images) == 12
    index, generator = torch.arange(12), torch.Generator().manual_seed(0)
    with_geometry = images.batch(index, config, Augmentation(no_geometry=0), generator).condition
    without = images.batch(index, config, NO_AUGMENTATION, generator).condition
    assert with_geometry.shape == (12, 8, 16, 16)
    assert bool((with_geometry[:, 4:].abs().sum((1, 2, 3)) > 0).all())
    assert bool((without[:, 4:] == 0).all())


INFO = ShardInfo(seed=3, first=512, count=2, size=5, redrawn=1)


def tensors(count=2, size=5):
    generator = torch.Generator().manual_seed(1)
    return {name: torch.rand(count, size, size, n, generator=generator) for name, n in CHANNELS.items()}


def test_round_trip_in_half_precision_and_nothing_left_beside(tmp_path):
    written = tensors()
    write_shard(shard_path(tmp_path, 2), written, INFO)
    read, info = load_shard(shard_path(tmp_path, 2))
    assert info == INFO
    assert all(torch.equal(read[name], written[name].half()) for name in CHANNELS)
    assert [path.name for path in tmp_path.iterdir()] == ["shard_00002.safetensors"]
    assert shard_paths(tmp_path) == [shard_path(tmp_path, 2)]
