"""Cells of a published table run again: which are drawn, what is said of each, and that none is passed over in silence."""

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from scored_runs import scored

from ia_bench.cli.verify import main
from ia_bench.common.errors import InputError
from ia_bench.report.again import drawn, overrides_of, repeat
from ia_bench.report.collect import HASH_DIGITS, as_table, read_published
from ia_bench.report.findings import Collection, analyse
from ia_bench.report.write import _runs_text
from ia_bench.runs.composition import compose
from ia_bench.runs.identity import hash_of, identity

Write = Callable[..., Path]
PROTOCOL = "paper-v1 (lpips.net=alex)"  # of the runs that write_run writes
SETTINGS = ["scene=tiny", "prior=none", "seed=0", "row='ours, 2'"]


@pytest.fixture(scope="module")
def here() -> str:
    """The identity of the published run, which has one thread."""
    return hash_of(identity(compose([*SETTINGS, "threads=1"])))[:HASH_DIGITS]


@pytest.fixture
def published(tmp_path: Path, here: str) -> Path:
    """A runs.csv: a run that can be repeated, one of another identity, one of a former version, one that failed."""
    one = {"protocol": PROTOCOL, "command": "scene=tiny prior=none seed=0 'row='\"'\"'ours, 2'\"'\"''", "threads": 1}
    runs = [
        scored("ours, 2", "tiny", 0, None, **one, config_hash=here, albedo_psnr=20.0, roughness_mse=0.05),
        scored("changed", "tiny", 0, 1.0, **one, config_hash="0" * HASH_DIGITS),
        scored("former", "tiny", 0, 1.0, protocol=PROTOCOL),
        scored("open", "tiny", 0, 1.0, **{**one, "command": "scene=tiny row='x"}, config_hash="0" * HASH_DIGITS),
        scored("failed", "tiny", 0, None, problem="no"),
    ]
    (tmp_path / "table").mkdir()
    (tmp_path / "table" / "runs.csv").write_text(_runs_text(analyse(Collection(as_table(runs)))))
    return tmp_path / "table"


@pytest.fixture
def repeats(monkeypatch: pytest.MonkeyPatch, write_run: Write, tmp_path: Path) -> Callable[..., list[list[str]]]:
    """A function that makes every run leave the same record, or fail; it returns the commands that are run."""
    commands: list[list[str]] = []

    def run(psnr: float, error: str = "") -> list[list[str]]:
        folder = write_run("again", "tiny", psnr=psnr)

        def ran(command: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
            commands.append(command)
            folder.rename(Path(command[-1].removeprefix("out=")))
            return subprocess.CompletedProcess(command, int(bool(error)), "", error)

        monkeypatch.setattr(subprocess, "run", ran)
        return commands

    return run


def test_a_share_is_drawn_by_its_seed_and_is_never_empty() -> None:
    runs = [scored("ours", "hat", seed, 1.0) for seed in range(40)] + [scored("ours", "hat", 99, None, problem="no")]
    some = [run["seed"] for run in drawn(runs, 0.1, 0)]
    assert len(some) == 4
    assert some == [run["seed"] for run in drawn(runs, 0.1, 0)] == sorted(some)
    assert some != [run["seed"] for run in drawn(runs, 0.1, 1)]
    assert [len(drawn(runs[:count], 0.1, 0)) for count in (3, 30, 31)] == [1, 3, 4]
    assert len(drawn(runs, 1.0, 0)) == 40, "what has failed has no score"


def test_a_published_run_knows_its_settings_but_one_that_was_scored_again_has_no_command(published: Path) -> None:
    (run,) = [run for run in read_published(published / "runs.csv") if run["row"] == "ours, 2"]
    assert overrides_of(run) == [*SETTINGS, "threads=1"]
    with pytest.raises(InputError, match="scored again, under paper-v1"):
        overrides_of(run | {"rescored_from_config_hash": "0" * 64})


@pytest.mark.parametrize(
    ("psnr", "error", "status", "words"),
    [
        (20.0009, "", 0, "ours, 2, tiny, seed 0: agrees"),
        (20.0011, "", 1, "ours, 2, tiny, seed 0: differs"),
        (20.0, "Traceback\nno light\n", 1, "not run again: it fails now: no light"),
    ],
)
def test_scores_stand_side_by_side(
    published: Path, repeats: Any, capsys: pytest.CaptureFixture[str], psnr: float, error: str, status: int, words: str
) -> None:
    commands = repeats(psnr, error)
    lines = (published / "runs.csv").read_text().splitlines(keepends=True)
    (published / "runs.csv").write_text(
        "".join(line for line in lines if not line.startswith((f"{PROTOCOL},changed", f"{PROTOCOL},former", f"{PROTOCOL},open")))
    )
    assert main([str(published)]) == status
    assert commands[0][3:-1] == ["run", *SETTINGS, "threads=1"]
    told = capsys.readouterr().out
    assert words in told
    assert (f"  albedo.psnr                20.000000{psnr:>12.6f}{psnr - 20:>+12.6f}" in told) == (not error)
    assert ("<-" in told) == ("differs" in words)


def test_what_cannot_be_run_again_says_why(published: Path, repeats: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """Where settings have changed since, the scores decide."""
    lines = (published / "runs.csv").read_text().splitlines(keepends=True)
    (published / "runs.csv").write_text("".join(line for line in lines if not line.startswith(f'{PROTOCOL},"ours')))
    repeats(1.0)
    assert main([str(published / "runs.csv"), "--share", "1"]) == 1
    told = capsys.readouterr().out
    assert "4 published cells, of which 3 are run again" in told
    assert "changed, tiny, seed 0: differs: its identity is " in told
    assert "former, tiny, seed 0: not run again: its runs.csv does not hold the command line" in told
    assert "open, tiny, seed 0: not run again: its command cannot be read (No closing quotation)" in told
    assert "1 differs, 2 not run again" in told.splitlines()[-1]


def test_a_run_that_was_published_without_its_hash_is_not_called_another_one(published: Path, repeats: Any, here: str) -> None:
    (run,) = [run for run in read_published(published / "runs.csv") if run["row"] == "ours, 2"]
    repeats(20.0)
    found = repeat(run | {"config_hash": None})
    assert (found.changed, found.problem, found.apart(1e-3)) == ("", "", [])
    repeats(20.0)
    changed = repeat(run | {"config_hash": "1", "commit": "abcd"}).changed
    assert f"its identity is {here} now, not 1: settings, weights, scene or code (abcd then, " in changed


def test_of_a_table_of_failures_alone_nothing_is_run_again(published: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = (published / "runs.csv").read_text().splitlines(keepends=True)
    (published / "runs.csv").write_text("".join(line for line in lines if f"{PROTOCOL}," not in line or ",failed," in line))
    assert main([str(published)]) == 1
    assert "runs.csv: expected a run that has not failed, found 1 that have" in capsys.readouterr().err


@pytest.mark.parametrize("share", ["0", "1.5", "-1", "half"])
def test_a_share_that_is_none_is_refused(published: Path, capsys: pytest.CaptureFixture[str], share: str) -> None:
    assert main([str(published), "--share", share]) == 2
    assert "above 0 and up to 1" in capsys.readouterr().err


def test_an_interrupted_verification_does_not_say_that_it_resumes(
    published: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("ia_bench.report.again.repeat", interrupted)
    assert main([str(published)]) == 130
    assert "interrupted; the same command starts over" in capsys.readouterr().err
