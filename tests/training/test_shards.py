"""Shards: what is written is read back; whatever else is refused with a message that names the file."""


import pytest
import torch
from safetensors.torch import save_file

from ia_bench.common.errors import InputError
from ia_bench_training.shards import CHANNELS, ShardInfo, load_shard, read_info, shard_path, shard_paths, write_shard

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


def test_missing_and_damaged_files_are_named(tmp_path):
    with pytest.raises(InputError, match=r"shard_00000.*no such shard"):
        read_info(shard_path(tmp_path, 0))
    with pytest.raises(InputError, match="found none"):
        shard_paths(tmp_path)
    path = shard_path(tmp_path, 0)
    write_shard(path, tensors(), INFO)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InputError, match=r"shard_00000.*cannot be read"):
        load_shard(path)
    save_file({"image": torch.zeros(1)}, path)
    with pytest.raises(InputError, match=r"shard_00000.*metadata"):
        load_shard(path)
