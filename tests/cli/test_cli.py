"""The command line around a run: mistakes, what is shown, and plugins; and every command behind one name.

The run itself is replaced by tests/fake_run, so that these tests take seconds and say nothing about rendering.
"""

import platform
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import call, results, started

from ia_bench.cli.main import COMMANDS
from ia_bench.cli.main import main as any_command
from ia_bench.cli.run import main
from ia_bench.common.paths import conf_folder
from ia_bench.runs.record import RunRecord

pytestmark = pytest.mark.usefixtures("workplace")
NUMBERS = {"prior": 1.5, "scene": -1, "coupling": -1, "protocol": "-0", "method": -3, "preset": "-inf"}
"""Where Hydra expects names."""


@pytest.mark.parametrize(
    ("mistake", "expected"),
    [
        ("preset=quik", "unknown preset 'quik'; did you mean 'quick'? There are: full, "),
        ("sed=1", "unknown setting 'sed'; did you mean 'seed'? There are: capture, coupling, device, "),
        ("fit.pixls=3", "unknown setting 'fit.pixls'; did you mean 'fit.pixels'? There are: "),
        ("protocol.lpips.net=sqeeze", "did you mean 'squeeze'?"),
        ("seed=1,2", "seed=1,2: expected one value; several runs are a table: ia-bench table seeds=0,1"),
        ("--multirun", "--multirun: expected one run, found a sweep: a table is many, ia-bench table --help"),
        ("fit.pixels=[", "cannot read 'fit.pixels=['"),
        ("seed", "seed: expected SETTING=VALUE, such as seed=VALUE; --help lists them"),
        ("scene.path=nowhere", "scene.path=nowhere: no such folder"),
        ("hydra/launcher=ray", "hydra/launcher=ray: expected a setting of a run, found one of Hydra's own"),
        ("method=null", "unknown method 'null'. There are: "),
        *((f"{group}={n}", f"unknown {group} '{n}'") for group, n in NUMBERS.items()),
        ("+prior=1e5", "unknown prior '1e5'"),
        ("prior@prior=1.5", "Could not override 'prior@prior'"),
        ("~protocol=-1", "Could not delete 'protocol=-1'"),
        ("prior=[none,oracle]", "prior: expected one name, found [none,oracle]"),
        ("+coupling=[1,2]", "coupling: expected one name, found [1,2]"),
        ("scene='\ud800'", r"scene: expected one name, found '\ud800'"),
        ("prior=./mine/foo.py:Bar", "found a path: PYTHONPATH=mine makes it prior=foo:Bar"),
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


def test_run_prints_its_numbers_and_is_never_repeated(capfd: pytest.CaptureFixture[str]) -> None:
    assert call("seed=3") == 0
    first = capfd.readouterr()
    assert "none, scene hat, seed 3, protocol paper-v3 (lpips.net=squeeze):\n  albedo          psnr 23" in first.out
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


def test_a_mistake_that_is_found_late_leaves_no_run_but_where_one_was_asked_for() -> None:
    """In a report it would be a method that has failed."""
    assert call("row=refused") == 2
    assert not Path("runs/hat").exists()
    assert call("row=refused", "out=here") == 2
    assert RunRecord.read(Path("here")).error == "capture.views=800: expected at most 16"
    assert call("row=raise", "out=runs/hat/mine") == 1
    assert call("row=refused") == 2
    assert [path.name for path in Path("runs/hat").iterdir()] == ["mine"]


def test_every_setting_can_be_shown(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["prior=oracle", "coupling=kernel", "--cfg", "job"]) == 0
    shown = capfd.readouterr().out
    assert main(["--cfg", "job", "prior=oracle", "coupling=kernel"]) == 0
    assert capfd.readouterr().out == shown
    assert "stage1_steps: " in shown
    assert "couplings.kernel:Kernel" in shown
    assert not Path("runs").exists()


def test_help_describes_every_choice(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    screen = capfd.readouterr().out
    assert len(screen.splitlines()) <= 40
    assert main(["--choices"]) == 0
    text = capfd.readouterr().out
    for path in conf_folder().glob("*/*.yaml"):
        if path.parent.name != "table":
            assert f" {path.stem} " in screen.replace("\n", " ")
            line = next(line for line in text.splitlines() if line.startswith(f"  {path.stem} "))
            assert len(line) > 28
            assert not line[19:].strip().startswith(("@", "ia-bench "))  # a directive of Hydra, a command
    assert max(map(len, (screen + text).splitlines())) <= 121
    described = {scene: text.partition(f"  {scene} ")[2].partition("\n  ")[0] for scene in ("bear", "hat")}
    assert {scene: "(not here)" in told for scene, told in described.items()} == {"bear": True, "hat": False}
    assert main(["--version"]) == 0
    assert capfd.readouterr().out.startswith("ia_bench 0.")


@pytest.mark.parametrize("system", ["Darwin", "Windows"])
def test_another_system_is_refused(system: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(platform, "system", lambda: system)
    assert any_command(["run", "scene=tiny"]) == 2
    assert capsys.readouterr().err == f"ia_bench: expected Linux, found {system}; docs/usage.md says what ia_bench runs on\n"


def test_help_lists_every_command_with_what_it_is_for():
    shown = subprocess.run([Path(sys.executable).with_name("ia-bench"), "--help"], capture_output=True, text=True)
    assert shown.returncode == 0
    assert all(f"  {name} " in shown.stdout and line in shown.stdout for name, line in COMMANDS.items())


HELP = """
import sys
from ia_bench.cli.main import main
try:
    status = main([sys.argv[1], "--help"])
except SystemExit as end:
    status = end.code
sys.exit(status or 3 * ("torch" in sys.modules))
"""


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_says_what_it_takes_without_torch(name):
    shown = subprocess.run([sys.executable, "-c", HELP, name], capture_output=True, text=True)
    assert shown.returncode == 0, shown.stderr or "torch, which takes seconds to load"
    assert name in shown.stdout
    assert len(shown.stdout.splitlines()) <= 40, "more than one screen"


def test_pages_of_tables_and_runs_need_no_torch():
    """Their pictures are drawn already."""
    code = "import sys, ia_bench.report.site.page, ia_bench.report.write\nassert {'torch', 'matplotlib'}.isdisjoint(sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
