import io
import json
import math
import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout

import pytest
import torch
from priors.tiny_network import tiny_weights
from training.test_dataset import shard

from ia_bench.priors.diffusion.encoding import encode
from ia_bench.priors.diffusion.network import load_network
from ia_bench_training.losses import log_error, weighted_error
from ia_bench_training.shards import ShardInfo, shard_path, write_shard
from ia_bench_training.train import main
from ia_bench_training.validation import aligned_psnr, psnr

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


def run_apart(arguments, launcher=()):
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "ACCELERATE_USE_CPU": "true"}
    line = [sys.executable, "-m", *launcher, "ia_bench_training.train", *arguments]
    return subprocess.run(line, capture_output=True, text=True, env=environment)


@pytest.fixture(autouse=True)
def same_process(monkeypatch):
    """What a command changes of the process is put back."""
    monkeypatch.setenv("ACCELERATE_USE_CPU", "true")
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def run(arguments):
    """The command in this process, which has imported already what takes a command seconds."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = main(arguments)
    return subprocess.CompletedProcess(arguments, status, out.getvalue(), err.getvalue())


def train(arguments):
    ended = run(arguments)
    assert ended.returncode == 0, ended.stderr
    return ended


def test_the_loss_weighs_an_images_mean_error_apart():
    """A constant error counts ``level``, one without a mean its whole square, wherever the other one is."""
    masks = torch.zeros(2, 8, 8)
    masks[0, :4], masks[1] = 0.5, 1
    inside = (masks > 0).float()[:, None]
    constant = torch.tensor([0.3, -0.5])[:, None, None, None] * inside.expand(2, 6, 8, 8)
    waves = 0.2 * (-1.0) ** torch.arange(8) * inside.expand(2, 6, 8, 8)
    outside = 0.7 * (1 - inside).expand(2, 6, 8, 8)
    pixels = 32 + 64 + 0.1 * 32
    for level in (0, 0.25, 1):
        expected = (level * (32 * 0.3**2 + 64 * 0.5**2) + 96 * 0.2**2 + 0.1 * 32 * 0.7**2) / pixels
        found = weighted_error(constant + waves + outside, masks, level=level, background=0.1)
        assert float(found) == pytest.approx(expected, rel=1e-5)


def test_the_logarithm_of_the_error_is_the_score():
    """Of images whose errors are not small it is the score itself, whatever their levels; and black has a gradient."""
    generator = torch.Generator().manual_seed(0)
    masks = (torch.rand(5, 8, 8, generator=generator) > 0.3).float()
    truth, found = (torch.rand(5, 8, 8, 3, generator=generator) * masks[..., None] for _ in range(2))
    scored = aligned_psnr(found, truth, masks > 0.5, channels=False)
    level = torch.tensor([0.2, 0.5, 0.7, 0.9, 1.0])[:, None, None, None]
    encoded = [encode("albedo", linear, masks, torch.ones(5)) for linear in (level * found, truth)]
    assert float(log_error(*encoded, masks, aligned=True)) == pytest.approx(float(-scored.mean() * math.log(10) / 10), abs=5e-3)
    encoded[0] = encode("specular", found, masks, torch.ones(5))
    unscaled = psnr(found, truth, masks > 0.5)
    assert float(log_error(*encoded, masks, aligned=False)) == pytest.approx(float(-unscaled.mean() * math.log(10) / 10), abs=5e-3)
    black = torch.full((1, 3, 8, 8), -1.0, requires_grad=True)
    log_error(black, encoded[1][:1], masks[:1], aligned=True).backward()
    assert bool(black.grad.isfinite().all())


def weights_of(folder):
    return load_network(folder / "weights")[0].state_dict()


def test_a_resumed_run_ends_with_the_weights_of_an_uninterrupted_one(folders, tmp_path):
    given = "steps=4", "noise_alone=0.5", "log_error=0.01"
    train(command(folders, tmp_path / "whole", *given))
    # Stopped by its time limit after the first step; the next command goes on.
    train(command(folders, tmp_path / "parts", *given, "minutes=0"))
    assert json.loads((tmp_path / "parts/weights/prior.json").read_text())["provenance"]["steps"] == 1
    train(command(folders, tmp_path / "parts", *given))
    whole, parts = weights_of(tmp_path / "whole"), weights_of(tmp_path / "parts")
    for name, value in whole.items():
        assert torch.equal(value, parts[name]), name


def test_training_improves_the_samples_and_is_followed(folders, tmp_path):
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


def test_training_starts_from_given_weights(folders, tmp_path):
    start = tiny_weights(tmp_path / "start", seed=5, head=32)
    train(command(folders, tmp_path / "run", "steps=1", f"init={start}", "rate=1e-9", "muon_rate=0", "warmup=0"))
    network, provenance = load_network(tmp_path / "run/weights")
    for name, value in load_network(start)[0].state_dict().items():
        torch.testing.assert_close(network.state_dict()[name], value, atol=1e-4, rtol=1e-3)
    assert provenance["init"] == {"steps": 0}


def test_a_diffusion_model_starts_as_the_regressor_that_it_is_given(folders, tmp_path):
    """Whatever noise it sees and is told of, its first estimate is the regressor's."""
    start = tiny_weights(tmp_path / "start", kind="regressor", seed=5, head=32)
    train(command(folders, tmp_path / "run", "steps=1", f"init={start}", "rate=1e-9", "muon_rate=0", "warmup=0"))
    network, regressor = load_network(tmp_path / "run/weights")[0], load_network(start)[0]
    images, noise = torch.rand(2, network.config.condition_channels, 16, 16), torch.randn(2, 6, 16, 16)
    last = torch.full((2,), network.config.timesteps - 1)
    torch.testing.assert_close(network(noise, torch.tensor([3, 900]), images), regressor(None, last, images), atol=1e-3, rtol=1e-3)


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ("init={start} network.tokens=32", "init"),
        ("init={start} network.kind=regressor", "expected a regressor"),
        ("network.kind=regressor noise_alone=.5", "noise_alone: expected 0 but for a diffusion model"),
        ("mixture.meshes=.9", "mixture: expected none but for a world"),
    ],
)
def test_what_does_not_go_together_is_refused(folders, tmp_path, given, why):
    start = tiny_weights(tmp_path / "start", seed=5, head=32)
    ended = run(command(folders, tmp_path / "other", "steps=1", *given.format(start=start).split()))
    assert ended.returncode == 2
    assert why in ended.stderr


@pytest.mark.slow
def test_two_processes_train_together(folders, tmp_path):
    """Without random numbers in a batch, two halves of it make the step of the whole: only if gradients are averaged."""
    still = [f"augmentation.{name}=0" for name in ("mirror", "permute", "cast", "exposure", "noise", "tone", "eight_bits")]
    plain = ("steps=3", "network.kind=regressor", "ema=0", "augmentation.no_geometry=1", *still)
    train(command(folders, tmp_path / "one", *plain))
    ended = run_apart(command(folders, tmp_path / "two", *plain), ("torch.distributed.run", "--nproc_per_node", "2", "-m"))
    assert ended.returncode == 0, ended.stderr
    provenance = load_network(tmp_path / "two/weights")[1]
    assert (provenance["processes"], provenance["steps"]) == (2, 3)
    train(command(folders, tmp_path / "half", *plain, "batch=2"))
    runs = [weights_of(tmp_path / name).values() for name in ("one", "two", "half")]
    one, two, half = (torch.cat([value.flatten() for value in values]) for values in runs)
    assert float((two - one).norm()) < 0.05 * float((half - one).norm())
