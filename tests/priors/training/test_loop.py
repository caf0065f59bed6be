import json
import os
import subprocess
import sys

import pytest
import torch
from priors.tiny_network import tiny_weights
from priors.training.test_dataset import shard
from safetensors.torch import load_file

from ia_bench.errors import InputError
from ia_bench.priors.diffusion.checkpoints import UNET, load_network
from ia_bench.priors.training.loop import FINAL_RATE, batch_index, rate_factor
from ia_bench.priors.training.settings import TrainSettings, parse, usage
from ia_bench.priors.training.shards import ShardInfo, shard_path, write_shard

SMALL = ["network.size=16", "network.channels=[16,32]", "network.tokens=16", "batch=4", "warmup=2", "compile=false"]
QUICK = ["validate_steps=1000", "validation_images=4", "validation_sampler_steps=2", "precision=float32", "threads=1"]


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    root = tmp_path_factory.mktemp("shards")
    for name, seed in (("data", 0), ("validation", 1)):
        (root / name).mkdir()
        write_shard(shard_path(root / name, 0), shard(count=12, seed=seed), ShardInfo(seed, 0, 12, 16))
    return root


def command(folders, out, *more):
    return [f"data={folders / 'data'}", f"validation={folders / 'validation'}", f"out={out}", *SMALL, *QUICK, *more]


def run(arguments, launcher=()):
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "ACCELERATE_USE_CPU": "true"}
    started = [sys.executable, "-m", *launcher, "ia_bench.priors.train", *arguments]
    return subprocess.run(started, capture_output=True, text=True, check=False, env=environment)


def train(arguments):
    ended = run(arguments)
    assert ended.returncode == 0, ended.stderr
    return ended


def test_every_image_is_seen_once_in_every_pass():
    images, batch = 10, 4
    seen = torch.cat([batch_index(images, batch, 3, step) for step in range(5)])
    for epoch in range(2):
        assert sorted(seen[epoch * images : (epoch + 1) * images].tolist()) == list(range(images))
    assert not torch.equal(seen[:images], seen[images:])
    assert torch.equal(batch_index(images, batch, 3, 4), seen[16:])


def test_a_batch_larger_than_the_data_takes_several_passes():
    assert torch.bincount(batch_index(3, 8, 0, 0), minlength=3).tolist() in ([3, 3, 2], [3, 2, 3], [2, 3, 3])


def test_the_rate_rises_and_falls():
    factors = [rate_factor(step, 100, 10) for step in range(101)]
    assert factors[0] == pytest.approx(0.1)
    assert factors.index(max(factors)) in (9, 10)
    assert factors[-1] == pytest.approx(FINAL_RATE)


def test_a_resumed_run_ends_with_the_weights_of_an_uninterrupted_one(folders, tmp_path):
    train(command(folders, tmp_path / "whole", "steps=4"))
    # Stopped by its time limit after the first step; the next command goes on.
    train(command(folders, tmp_path / "parts", "steps=4", "minutes=0"))
    assert json.loads((tmp_path / "parts/weights/prior.json").read_text())["provenance"]["steps"] == 1
    train(command(folders, tmp_path / "parts", "steps=4"))
    whole, parts = (load_file(tmp_path / name / "weights" / UNET) for name in ("whole", "parts"))
    for name, value in whole.items():
        assert torch.equal(value, parts[name]), name


def test_training_lowers_the_loss_and_is_followed(folders, tmp_path):
    ended = train(command(folders, tmp_path / "run", "steps=30", "rate=3e-3", "validate_steps=15"))
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(tmp_path / "run/tensorboard"), size_guidance={"scalars": 0}).Reload()
    assert {"loss", "rate", "validation/albedo_mean", "validation/specular_one"} <= set(events.Tags()["scalars"])
    assert events.Tags()["images"] == ["validation"]
    rows = [json.loads(line) for line in (tmp_path / "run/validation.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == [15, 30]
    assert rows[1]["specular_one"] > rows[0]["specular_one"]
    assert "weights in" in ended.stdout + ended.stderr
    network, provenance = load_network(tmp_path / "run/weights")
    assert provenance["steps"] == 30
    assert network.config.channels == (16, 32)


def test_the_regressor_trains_by_the_same_command(folders, tmp_path):
    train(command(folders, tmp_path / "run", "steps=2", "network.kind=regressor"))
    network, _ = load_network(tmp_path / "run/weights")
    assert network.config.kind == "regressor"
    assert network.unet.config.in_channels == 4 * 8  # no noise goes in


def test_training_starts_from_given_weights(folders, tmp_path):
    start = tiny_weights(tmp_path / "start", seed=5, prediction_type="sample")
    train(command(folders, tmp_path / "run", "steps=1", f"init={start}", "rate=1e-9", "warmup=0"))
    network, provenance = load_network(tmp_path / "run/weights")
    for name, value in load_network(start)[0].state_dict().items():
        torch.testing.assert_close(network.state_dict()[name], value, atol=1e-4, rtol=1e-3)
    assert provenance["init"] == {"steps": 0}
    ended = run(command(folders, tmp_path / "other", "steps=1", f"init={start}", "network.tokens=32"))
    assert ended.returncode == 2
    assert "init" in ended.stderr


@pytest.mark.slow
def test_two_processes_train_together(folders, tmp_path):
    ended = run(command(folders, tmp_path / "two", "steps=3"), ("torch.distributed.run", "--nproc_per_node", "2", "-m"))
    assert ended.returncode == 0, ended.stderr
    _, provenance = load_network(tmp_path / "two/weights")
    assert provenance["processes"] == 2
    assert provenance["steps"] == 3
    assert all(bool(torch.isfinite(value).all()) for value in load_file(tmp_path / "two/weights" / UNET).values())


def test_another_run_in_the_folder_is_refused(folders, tmp_path):
    train(command(folders, tmp_path / "run", "steps=1"))
    ended = run(command(folders, tmp_path / "run", "steps=1", "rate=1e-3"))
    assert ended.returncode == 2
    assert "other settings" in ended.stderr


def test_arguments_are_typed():
    settings = parse(["data=a", "validation=b", "out=c", "rate=1e-4", "network.channels=[16,32]", "network.fold=4", "minutes=3"])
    assert isinstance(settings, TrainSettings)
    assert (settings.rate, settings.network.channels, settings.network.fold, settings.minutes) == (1e-4, (16, 32), 4, 3)
    assert "network.channels" in usage()


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("stepz=3", "did you mean 'steps'"),
        ("steps=many", "steps: expected a whole number, found 'many'"),
        ("rate=fast", "rate: expected a number, found 'fast'"),
        ("network.kind=difusion", "did you mean 'diffusion'"),
        ("network.size=60", "expected a multiple of 8"),
        ("network.channels=[40]", "expected multiples of 16"),
        ("steps=0", "steps: expected at least 1"),
        ("precision=half", "unknown value of precision"),
    ],
)
def test_mistakes_name_the_key(argument, message):
    with pytest.raises(InputError, match=message):
        parse(["data=a", "validation=b", "out=c", argument])
