"""``python -m ia_bench_training.prior_data``: its arguments, what it refuses, and that a kill loses no finished shard."""

import builtins
import io
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from ia_bench.common.errors import Fault, InputError
from ia_bench.common.progress import Progress
from ia_bench_training import prior_data
from ia_bench_training.generate import render_images
from ia_bench_training.palettes import MAX_ALBEDO, MIN_ALBEDO
from ia_bench_training.pool import share_out
from ia_bench_training.prior_data import ImageRequest, make_data
from ia_bench_training.render import MAX_COVERAGE, MIN_COVERAGE
from ia_bench_training.shading import DirectLight
from ia_bench_training.shards import CHANNELS, ShardInfo, load_shard, shard_path, write_shard


def fake_shard(path, **changes):
    info = ShardInfo(**{"seed": 0, "first": 0, "count": 3, "size": 16, **changes})
    write_shard(path, {name: torch.rand(info.count, 16, 16, n) for name, n in CHANNELS.items()}, info)


def test_finished_shards_are_kept_and_others_refused(tmp_path, monkeypatch):
    rendered = []
    monkeypatch.setattr(prior_data, "_render", lambda request, progress, shards, advance: rendered.extend(shards))
    fake_shard(shard_path(tmp_path, 0))
    (tmp_path / ".tmp-shard_00001.safetensors").write_bytes(b"half")
    with Progress() as progress:
        make_data(ImageRequest(tmp_path, images=3, size=16), progress)
        assert rendered == []
        assert not list(tmp_path.glob(".tmp-*"))
        assert (tmp_path / "contact_sheet.png").exists()
        for wrong in (ImageRequest(tmp_path, images=3, size=16, seed=1), ImageRequest(tmp_path, images=3, size=64)):
            with pytest.raises(InputError, match="Give another out= folder"):
                make_data(wrong, progress)
        for more in (2, 1):  # in the shard, and in another one
            with pytest.raises(InputError, match="expected at most images=2, found more. Give another out= folder"):
                make_data(ImageRequest(tmp_path, images=2, size=16), progress)
            if more == 2:
                fake_shard(shard_path(tmp_path, 1))
        shard_path(tmp_path, 1).unlink()
        make_data(ImageRequest(tmp_path, images=5, size=16), progress)  # the shard is short of two
        assert rendered == [(shard_path(tmp_path, 0), 0, 5)]


def arguments(folder):
    command = [sys.executable, "-m", "ia_bench_training.prior_data", f"out={folder}"]
    return [*command, "images=264", "size=8", "workers=2", "compile=false"]


@pytest.mark.slow
def test_a_killed_run_is_resumed_to_the_same_bytes(tmp_path):
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    subprocess.run(arguments(whole), check=True)
    process = subprocess.Popen(arguments(killed), start_new_session=True)
    while not list(killed.glob("shard_*")):
        assert process.poll() is None, "ended before it could be killed"
        time.sleep(0.02)
    process.kill()
    process.wait()
    deadline = time.monotonic() + 1200
    while subprocess.run(["pgrep", "-g", str(process.pid)], stdout=subprocess.DEVNULL).returncode == 0:
        assert time.monotonic() < deadline, "workers outlive the run"
        time.sleep(0.1)
    kept = {path.name: path.stat().st_mtime_ns for path in killed.glob("shard_*")}
    subprocess.run(arguments(killed), check=True)
    assert all((killed / name).stat().st_mtime_ns == stamp for name, stamp in kept.items())
    for path in sorted(whole.glob("shard_*")):
        (a, first), (b, second) = load_shard(path), load_shard(killed / path.name)
        assert first == second
        assert all(torch.equal(a[name], b[name]) for name in CHANNELS)


def test_a_worker_that_is_killed_is_one_sentence():
    with pytest.raises(Fault, match=r"a worker process was killed, .* the same command goes on"):
        list(share_out(os._exit, [(9,)], workers=1))


SIDE = 24
DIRECT = DirectLight(compiled=False)


@pytest.fixture(scope="module")
def images():
    return render_images(11, 0, 12, SIDE, DIRECT)[0]


def test_the_same_call_gives_the_same_bits_and_an_image_is_the_same_beside_any_other(images):
    again, _ = render_images(11, 0, 8, SIDE, DIRECT)
    assert all(torch.equal(again[name], images[name][:8]) for name in CHANNELS)
    alone, _ = render_images(11, 5, 2, SIDE, DIRECT)
    across, _ = render_images(11, 7, 2, SIDE, DIRECT)
    for name in CHANNELS:
        torch.testing.assert_close(alone[name], images[name][5:7], rtol=2e-3, atol=2e-3)
        torch.testing.assert_close(across[name], images[name][7:9], rtol=2e-3, atol=2e-3)
    other, _ = render_images(12, 5, 1, SIDE, DIRECT)
    assert not torch.equal(other["albedo"], alone["albedo"][:1])


def test_targets_are_consistent(images):
    values = {name: image.float() for name, image in images.items()}
    coverage = values["image"][..., 3:]
    full = coverage[..., 0] == 1
    assert {name: tuple(v.shape) for name, v in values.items()} == {n: (12, SIDE, SIDE, c) for n, c in CHANNELS.items()}
    assert all(torch.isfinite(v).all() for v in values.values())
    mean_coverage = coverage.mean((1, 2, 3))
    assert mean_coverage.min() > MIN_COVERAGE
    assert mean_coverage.max() < MAX_COVERAGE
    assert all((v[(coverage == 0).expand_as(v)] == 0).all() for v in values.values())
    diffuse = values["image"][..., :3] - values["specular"]
    assert (diffuse >= -2e-3 * values["image"][..., :3]).all()  # half precision
    assert values["albedo"][full].min() >= MIN_ALBEDO - 1e-3
    assert values["albedo"][full].max() <= MAX_ALBEDO + 1e-3
    assert values["normal"].norm(dim=-1).max() <= 1.002
    assert (values["normal"][..., 2][full] > -0.02).all()  # toward the camera, up to its perspective and grazing pixels
    assert ((values["visibility"] >= 0) & (values["visibility"] <= coverage + 1e-3)).all()
    level = values["image"][..., :3].mean(-1).sum((1, 2)) / coverage.sum((1, 2, 3))
    assert ((level > 0.1) & (level < 0.9)).all()


def test_the_generator_opens_no_file(monkeypatch):
    """It is asked for numbers only; what it must not import is in training/pyproject.toml."""
    render_images(2, 0, 1, 8, DIRECT)  # whatever is loaded on first use

    def refuse(*arguments, **options):
        raise AssertionError(f"opened {arguments}")

    monkeypatch.setattr(builtins, "open", refuse)
    monkeypatch.setattr(io, "open", refuse)
    monkeypatch.setattr(Path, "open", refuse)
    render_images(2, 0, 1, 8, DIRECT)
