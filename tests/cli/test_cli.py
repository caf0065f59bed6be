"""The command line around a run: mistakes, resuming, two at once, sweeps, plugins, and a real installation.

The run itself is replaced by tests/fake_run, so that these tests take seconds and say nothing about rendering.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from PIL import Image

from ia_bench.cli.run import main
from ia_bench.common.paths import conf_folder
from ia_bench.runs.checkpoint import pack

HERE = Path(__file__).parent


@pytest.fixture(autouse=True)
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty current folder, two scenes, and the fake run in this process and in those it starts."""
    for scene in ("hat", "ship"):
        (tmp_path / "datasets" / "scenes" / scene).mkdir(parents=True)
    monkeypatch.setenv("IA_BENCH_DATASETS", str(tmp_path / "datasets"))
    monkeypatch.setenv("FAKE_LOG", str(tmp_path / "log"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(HERE / "fake_run"), str(HERE.parents[1])]))
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")  # main sets it; this puts it back afterwards
    monkeypatch.delenv("IA_BENCH_DEBUG", raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.setitem(sys.modules, "ia_bench.runs.run", sys)  # recorded, so that what install() does is undone
    monkeypatch.setattr(sys, "argv", ["ia_bench"])
    spec = importlib.util.spec_from_file_location("fake_run", HERE / "fake_run" / "sitecustomize.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    return work


def call(*arguments: str) -> int:
    return main(["device=cpu", "threads=1", *arguments])


def started() -> list[str]:
    """One line per start of the fake run."""
    log = Path(os.environ["FAKE_LOG"])
    return log.read_text().splitlines() if log.exists() else []


def results() -> list[dict]:
    return [json.loads(path.read_text()) for path in sorted(Path("runs").rglob("metrics.json"))]


@pytest.mark.parametrize(
    ("mistake", "expected"),
    [
        ("preset=quik", "unknown preset 'quik'; did you mean 'quick'? There are: full, paper, quick, smoke"),
        ("scene=hatt", "unknown scene 'hatt'; did you mean 'hat'? There are: console, "),
        ("prior=orcale", "unknown prior 'orcale'; did you mean 'oracle'?"),
        ("sed=1", "unknown setting 'sed'; did you mean 'seed'? There are: device, "),
        ("presett=quick", "unknown setting 'presett'; did you mean 'preset'?"),
        ("fit.pixls=3", "unknown setting 'fit.pixls'; did you mean 'fit.pixels'? There are: "),
        ("+fit.pixls=3", "unknown setting 'fit.pixls'; did you mean 'fit.pixels'?"),
        ("fit.rates.lite=3", "unknown setting 'fit.rates.lite'; did you mean 'fit.rates.light'?"),
        ("protocol.lpips.nett=alex", "unknown setting 'protocol.lpips.nett'; did you mean 'protocol.lpips.net'?"),
        ("protocol.lpips.net=sqeeze", "did you mean squeeze?"),
        ("protocol=papre-v2", "unknown protocol 'papre-v2'; did you mean 'paper-v2'?"),
        ("reader=nativ", "unknown reader 'nativ'; did you mean 'native'?"),
        ("reader.options.vu=mesh", "unknown setting 'reader.options.vu'; did you mean 'reader.options.uv'?"),
        ("render.texture=big", "unknown value of render.texture: 'big'"),
        ("seed=abc", "seed: expected a whole number, found 'abc'"),
        ("seed=-1", "seed: expected 0 or more, found -1"),
        ("threads=0", "threads: expected 1 or more, found 0"),
        ("fit=3", "fit: "),
        ("seed=1,2", "To sweep over it, add --multirun"),
        ("fit.pixels=[", "cannot read 'fit.pixels=['"),
        ("seed", "cannot read 'seed'"),
        ("scene.path=nowhere", "scene.path=nowhere: no such folder"),
        ("hydra/launcher=rai", "unknown hydra/launcher 'rai'"),
        ("method=null", "unknown method 'null'. There are: "),
        ("protocol=", "unknown protocol ''. There are: "),
        ("--resolve", "--resolve flag can only be used"),
        ("hydra.run.dir=/dev/null/x", "Not a directory: '/dev/null/x'"),
        ("prior=nowhere:Thing", "importing nowhere:Thing raised ModuleNotFoundError: No module named 'nowhere'"),
    ],
)
def test_mistake_is_one_message(mistake: str, expected: str, capfd: pytest.CaptureFixture[str]) -> None:
    status = call(mistake)
    out, err = capfd.readouterr()
    assert (status, out) == (2, "")
    assert expected in err
    assert err.startswith("ia_bench: ")
    assert err.count("\n") == 1
    assert not Path("runs").exists()


@pytest.mark.skipif(importlib.util.find_spec("ray") is not None, reason="the extra is installed")
def test_launcher_of_a_missing_extra_says_how_to_get_it(capfd: pytest.CaptureFixture[str]) -> None:
    assert call("-m", "hydra/launcher=ray", "seed=0,1") == 2
    assert "pip install -e '.[ray]'" in capfd.readouterr().err


def test_debugging_shows_the_traceback(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("IA_BENCH_DEBUG", "1")
    assert call("preset=quik") == 2
    said = capfd.readouterr().err
    assert "Traceback" in said
    assert "preset/quik" in said, "Hydra's own words"
    assert said.splitlines()[-1].startswith("ia_bench: unknown preset 'quik'")


def test_run_prints_its_numbers_and_is_never_repeated(capfd: pytest.CaptureFixture[str]) -> None:
    assert call("seed=3") == 0
    first = capfd.readouterr()
    assert "none, scene hat, seed 3, protocol paper-v2 (lpips.net=squeeze):\n  albedo          psnr 23" in first.out
    assert "stage 1: 40/40, loss 0.025" in first.err
    (folder,) = Path("runs/hat").iterdir()
    assert folder.name.startswith("none-")
    assert sorted(p.name for p in folder.iterdir()) == [".lock", "config.json", "curve.csv", "metrics.json"]
    assert call("seed=3") == 0
    second = capfd.readouterr()
    assert second.out == first.out
    assert "already finished" in second.err
    assert started() == ["hat none 3"]
    assert sorted(p.name for p in Path().iterdir()) == ["runs"], "Hydra leaves nothing of its own"


def test_internal_fault_has_a_traceback_a_record_and_a_second_try(capfd: pytest.CaptureFixture[str]) -> None:
    assert call("row=raise") == 1
    assert "RuntimeError: boom" in capfd.readouterr().err
    assert [(r["status"], r["error"]) for r in results()] == [("failed", "RuntimeError: boom")]
    assert call("row=raise") == 1
    assert len(started()) == 2


def test_folder_of_another_configuration_is_refused(capfd: pytest.CaptureFixture[str]) -> None:
    assert call("out=here") == 0
    capfd.readouterr()
    assert call("out=here", "fit.pixels=7") == 2
    assert "here: holds the results of another configuration; these differ: method.options.pixels (4096 there, 7 here)" in (
        capfd.readouterr().err
    )


def test_sweep_runs_every_combination(capfd: pytest.CaptureFixture[str]) -> None:
    assert call("-m", "seed=0,1", "scene=hat,ship") == 0
    assert sorted(started()) == ["hat none 0", "hat none 1", "ship none 0", "ship none 1"]
    assert len(results()) == 4
    assert sorted(p.name for p in Path().iterdir()) == ["runs"]
    capfd.readouterr()
    assert call("-m", "sed=0,1") == 2
    assert "did you mean 'seed'" in capfd.readouterr().err


def test_prior_of_another_distribution_needs_no_yaml(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    info = tmp_path / "site" / "third-1.2.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: third\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text("[ia_bench.priors]\nmine = third_module:Mine\n")
    prior = "class {}:\n    def __init__(self, strength=1): ...\n    def sample(self, observations, *, seed, guidance=None): ...\n"
    for module, name in (("third_module", "Mine"), ("their_module", "Theirs")):
        (tmp_path / "site" / f"{module}.py").write_text(prior.format(name))
    monkeypatch.syspath_prepend(tmp_path / "site")
    assert call("prior=mine", "prior.options.strength=2") == 0
    assert call("-m", "prior=none,mine,their_module:Theirs") == 0
    configs = [json.loads(path.read_text())["config"]["prior"] for path in sorted(Path("runs").rglob("config.json"))]
    configs = [{key: config[key] for key in ("name", "target", "options")} for config in configs]
    assert {"name": "mine", "target": "third_module:Mine", "options": {"strength": 2}} in configs
    assert {"name": "mine", "target": "third_module:Mine", "options": {}} in configs
    assert {"name": "their_module:Theirs", "target": "their_module:Theirs", "options": {}} in configs


def test_every_setting_can_be_shown(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["prior=oracle", "prior.supervision=similarity", "--cfg", "job"]) == 0
    shown = capfd.readouterr().out
    assert "stage1_steps: " in shown
    assert "kind: similarity" in shown
    assert not Path("runs").exists()


def test_help_describes_every_choice(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    text = capfd.readouterr().out
    for path in conf_folder().glob("*/*.yaml"):
        if path.parent.name != "table":
            line = next(line for line in text.splitlines() if line.startswith(f"    {path.stem} "))
            assert len(line) > 30
    assert max(map(len, text.splitlines())) <= 120
    assert "runs/<scene>/<row>-<hash>" in text


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "ia_bench", "device=cpu", "threads=1", *arguments]


def test_process_ends_with_status_2(workplace: Path) -> None:
    done = subprocess.run(command("preset=quik"), stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("ia_bench: unknown preset 'quik'; did you mean 'quick'?")
    assert "Traceback" not in done.stderr


def test_killed_run_resumes_to_the_same_numbers() -> None:
    assert call("out=whole") == 0
    slow = os.environ | {"FAKE_STEP_SECONDS": "0.05"}
    checkpoint = Path("killed/checkpoint.pt")
    for _ in range(2):
        process = subprocess.Popen(command("out=killed"), env=slow, stderr=subprocess.DEVNULL)
        before = checkpoint.stat().st_mtime_ns if checkpoint.exists() else 0
        deadline = time.monotonic() + 30
        while time.monotonic() < deadline and (not checkpoint.exists() or checkpoint.stat().st_mtime_ns == before):
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
        assert not Path("killed/metrics.json").exists()
    done = subprocess.run(command("out=killed"), capture_output=True, text=True, check=True)
    assert "resumed at " in done.stderr
    whole, killed = (json.loads(Path(name, "metrics.json").read_text()) for name in ("whole", "killed"))
    assert killed == whole


def interrupted(number: int, *arguments: str) -> tuple[int, str]:
    """Exit status and stderr of a run that gets a signal after its first checkpoint, or when it has begun if it is stuck."""
    slow = os.environ | {"FAKE_STEP_SECONDS": "0.2"}
    process = subprocess.Popen(command("out=stopped", *arguments), env=slow, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline and not (Path("stopped/checkpoint.pt").exists() or ("row=stuck" in arguments and started())):
        time.sleep(0.05)
    before = Path("stopped/checkpoint.pt")
    assert "row=stuck" in arguments or before.exists()
    process.send_signal(number)
    said = process.communicate(timeout=30)[1]
    return process.returncode, said


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_run_that_is_told_to_end_saves_and_resumes_to_the_same_numbers(number: int, status: int) -> None:
    assert call("out=whole") == 0
    found, said = interrupted(number)
    assert found == status
    assert said.splitlines()[-1] == "ia_bench: interrupted; the same command resumes"
    assert "Traceback" not in said
    assert not Path("stopped/metrics.json").exists()
    assert call("out=stopped") == 0
    whole, stopped = (json.loads(Path(name, "metrics.json").read_text()) for name in ("whole", "stopped"))
    assert stopped == whole
    assert not list(Path("stopped").glob("checkpoint*"))


def test_a_run_that_does_not_come_to_save_ends_all_the_same() -> None:
    status, said = interrupted(signal.SIGTERM, "row=stuck")
    assert (status, said.splitlines()[-1]) == (143, "ia_bench: interrupted; the same command resumes")


def _flip(content: bytes) -> bytes:
    return content[:1200] + bytes([content[1200] ^ 4]) + content[1201:]


@pytest.mark.parametrize("spoil", [_flip, lambda content: content[:500], lambda content: b"", lambda content: b"PK\3\4" * 99])
def test_a_spoiled_checkpoint_costs_time_and_no_number(spoil, capfd: pytest.CaptureFixture[str]) -> None:
    assert call("out=whole") == 0
    interrupted(signal.SIGTERM)
    path = Path("stopped/checkpoint.pt")
    path.write_bytes(spoil(path.read_bytes()))
    Path("stopped/.tmp-1-albedo.exr").write_bytes(b"half")
    Path("stopped/checkpoint-0123.pt").write_bytes(b"of another run")
    Path("stopped/notes.txt").write_text("of somebody else")
    capfd.readouterr()
    assert call("out=stopped") == 0
    assert "checkpoint ignored, starting over" in capfd.readouterr().err
    whole, stopped = (json.loads(Path(name, "metrics.json").read_text()) for name in ("whole", "stopped"))
    assert stopped == whole
    names = sorted(path.name for path in Path("stopped").iterdir())
    assert names == [".lock", "config.json", "curve.csv", "metrics.json", "notes.txt"]


def test_a_state_that_the_run_cannot_go_on_from_is_no_checkpoint(capfd: pytest.CaptureFixture[str]) -> None:
    """As whole as a checkpoint can be, of this code and configuration, and yet nothing that it could have written."""
    assert call("out=whole") == 0
    capfd.readouterr()
    assert call("out=odd", "row=raise") == 1
    held = json.loads(Path("odd/config.json").read_text())
    Path("odd/checkpoint.pt").write_bytes(pack({"kept": {}, "state": {"value": 3}}, held["config_hash"])[0])
    assert call("out=odd") == 0
    assert "checkpoint ignored, starting over (KeyError: 'step')" in capfd.readouterr().err
    whole, odd = (json.loads(Path(name, "metrics.json").read_text()) for name in ("whole", "odd"))
    assert odd == whole


def test_a_finished_run_that_lost_a_file_is_run_again(capfd: pytest.CaptureFixture[str]) -> None:
    assert call("out=here") == 0
    Path("here/curve.csv").unlink()
    capfd.readouterr()
    assert call("out=here") == 0
    assert "curve.csv: not what the run wrote there, or gone; running again" in capfd.readouterr().err
    assert Path("here/curve.csv").exists()
    assert len(started()) == 2


@pytest.mark.parametrize("redirect", ["> /dev/full", "| head -c 1", ">&-", "2> /dev/full", "2>&-", "> /dev/full 2>&1"])
def test_output_that_nobody_takes_costs_no_result(redirect: str) -> None:
    line = f"set -o pipefail; {' '.join(command())} {redirect}"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert "Traceback" not in done.stderr
    assert [record["status"] for record in results()] == ["ok"]


def test_a_home_that_cannot_be_written_is_in_nobodys_way() -> None:
    done = subprocess.run(command(), env=os.environ | {"HOME": "/proc/nowhere"}, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_one_bad_job_takes_no_other_with_it(workplace: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (workplace / "good").mkdir()
    assert call("-m", "scene.path=bad,good") == 2
    err = capfd.readouterr().err
    assert "ia_bench: scene.path=" in err
    assert "bad: no such folder" in err
    assert "Traceback" not in err
    assert [record["scene"] for record in results()] == ["good"]
    assert call("-m", "row=raise,good") == 1
    assert [record["status"] for record in results()] == ["ok", "ok", "failed"]


def test_two_at_once_share_one_result() -> None:
    slow = os.environ | {"FAKE_STEP_SECONDS": "0.05"}
    both = [subprocess.Popen(command(), env=slow, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    texts = [process.communicate(timeout=60)[1] for process in both]
    assert [process.returncode for process in both] == [0, 0]
    assert started() == ["hat none 0"]
    waited = [text for text in texts if "another process is working on this run" in text]
    assert len(waited) == 1
    assert "already finished" in waited[0]


@pytest.mark.slow
def test_installation_works_from_any_folder(tmp_path: Path) -> None:
    """`pip install .` into an empty environment; the dependencies are borrowed from this one, so nothing is loaded."""
    borrowed = next(path for path in sys.path if path.endswith("site-packages"))
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "FAKE_LOG")}
    python = tmp_path / "venv" / "bin" / "python"
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    (site,) = (tmp_path / "venv" / "lib").glob("python*/site-packages")
    (site / "borrowed.pth").write_text(borrowed + "\n")
    source = tmp_path / "source"
    shutil.copytree(HERE.parents[1] / "ia_bench", source / "ia_bench")
    shutil.copytree(HERE.parents[1] / "conf", source / "conf")
    for name in ("pyproject.toml", "README.md"):
        shutil.copy(HERE.parents[1] / name, source)
    pip = [python, "-m", "pip", "install", "--no-deps", "--no-build-isolation", "--no-index", "--quiet", source]
    subprocess.run(pip, check=True, env=environment)
    shutil.rmtree(source)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    run = {"cwd": elsewhere, "env": environment, "capture_output": True, "text": True, "check": False}
    where = subprocess.run([python, "-c", "import ia_bench; print(ia_bench.__file__)"], **run)
    assert where.stdout.startswith(str(site))
    shown = subprocess.run([python, "-m", "ia_bench", "--help"], **run)
    assert shown.returncode == 0, shown.stderr
    assert "paper-v2" in shown.stdout
    settings = subprocess.run([python, "-m", "ia_bench", "prior=oracle", "preset=paper", "--cfg", "job"], **run)
    assert "texture: 2048" in settings.stdout
    Image.new("RGB", (64, 64), (200, 120, 40)).save(elsewhere / "photo.png")
    decomposed = subprocess.run([python, "-m", "ia_bench.decompose", "photo.png", "--samples", "1", "--out", "parts"], **run)
    assert decomposed.returncode == 0, decomposed.stderr  # the weights are in the package
    assert (elsewhere / "parts/photo_albedo.exr").is_file()
    del environment["IA_BENCH_DATASETS"]
    without = subprocess.run([python, "-m", "ia_bench", "device=cpu"], **run)
    assert without.returncode == 2
    assert "IA_BENCH_DATASETS" in without.stderr
    assert "scene.path=FOLDER" in without.stderr


@pytest.mark.slow
def test_ray_runs_a_sweep(tmp_path: Path) -> None:
    pytest.importorskip("hydra_plugins.hydra_ray_launcher", reason="needs the extra: pip install -e '.[ray]'")
    environment = os.environ | {"RAY_AUTH_MODE": "disabled", "HOME": str(tmp_path)}
    arguments = command("-m", "hydra/launcher=ray", "seed=0,1")
    done = subprocess.run(arguments, env=environment, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    assert sorted(started()) == ["hat none 0", "hat none 1"]
    assert [r["status"] for r in results()] == ["ok", "ok"]
