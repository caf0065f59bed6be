"""``python -m ia_bench_training.prior_data``: its arguments, what it refuses, and that a kill loses no finished shard."""

import shutil
import subprocess
import sys
import time

import pytest
import torch

from ia_bench.common.errors import InputError
from ia_bench.common.progress import Progress
from ia_bench_training import data
from ia_bench_training.data import ImageRequest, choose_shading, make_data
from ia_bench_training.prior_data import main
from ia_bench_training.shards import CHANNELS, ShardInfo, load_shard, shard_path, write_shard


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["out=a", "image=3"], "unknown setting 'image'; did you mean 'images'"),
        (["out=a", "images=0"], "images: expected 1 or more, found 0"),
        (["out=a", "shading=eagre"], "did you mean 'eager'"),
        (["images=3"], "out: expected a value"),
    ],
)
def test_mistakes_are_named(arguments, message, capsys):
    assert main(arguments) == 2
    assert message in capsys.readouterr().err


def fake_shard(path, **changes):
    info = ShardInfo(**{"seed": 0, "first": 0, "count": 3, "size": 16, **changes})
    write_shard(path, {name: torch.rand(info.count, 16, 16, n) for name, n in CHANNELS.items()}, info)


def test_finished_shards_are_kept_and_others_refused(tmp_path, monkeypatch):
    rendered = []
    monkeypatch.setattr(data, "_render", lambda request, progress, shards, advance: rendered.extend(shards))
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
    return [*command, "images=264", "size=8", "workers=2", "shading=eager"]


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


@pytest.mark.parametrize(
    ("wanted", "compilers", "chosen"),
    [
        ("eager", ["g++"], "eager"),
        ("compiled", [], "compiled"),
        ("auto", ["g++"], "compiled"),
        ("auto", ["clang++"], "compiled"),
    ],
)
def test_choice_of_shading(monkeypatch, wanted, compilers, chosen):
    monkeypatch.setattr(shutil, "which", lambda name: name if name in compilers else None)
    notices = []
    assert choose_shading(wanted, notices.append) == chosen
    assert notices == []
