"""The whole report from run folders: every format, the paper's block, failures, foreign protocols, independence."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from ia_bench.report.latex import escape
from ia_bench.report.table import best_paper_methods, paper_rows
from ia_bench.report.write import Report, write_report
from ia_bench.runs.table import Claim
from ia_bench.scores.columns import METRICS

Write = Callable[..., Path]
ROOT = Path(__file__).parents[2]
CURVE = "stage1,0,0,10,10,10,10,0.1\nstage1,50,5,16,16,16,16,0.05\n"


@pytest.fixture(scope="module")
def report(write_run_below: Write, tmp_path_factory: pytest.TempPathFactory) -> Report:
    """Three rows on two scenes; ours has two seeds and a failure; one run was scored under another protocol."""
    root = tmp_path_factory.mktemp("report")
    write_run = partial(write_run_below, root)
    for scene, psnr in (("hat", 20.0), ("ship", 24.0)):
        write_run("none", scene, psnr=psnr - 4, curve=CURVE)
        write_run("oracle_*", scene, psnr=40.0, sees_truth=True, curve=CURVE)
        for seed in (0, 1):
            write_run("ours", scene, seed, psnr=psnr + seed, curve=CURVE)
    write_run("ours", "hat", 2, status="failed", error="loss is not finite at step 3")
    write_run("ours", "hat", 3, psnr=99.0, protocol="paper-v1 (lpips.net=vgg)")
    (root / "runs" / "torn").mkdir()
    (root / "runs" / "torn" / "metrics.json").write_text("{")
    claims = [Claim("ours", "none", ["albedo.psnr"]), Claim("later", "ours", ["roughness.mse"])]
    return write_report(
        root / "runs", root / "out", ["ours", "later"], scenes_order=["ship"], reference="none", claims=claims
    )


@pytest.fixture(scope="module")
def out(report: Report) -> Path:
    return report.files[0].parent


def test_every_file_is_written_and_nothing_partial_is_left(report: Report, out: Path) -> None:
    names = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    pictures = {f"curves/{scene}.{kind}" for scene in ("hat", "ship") for kind in ("png", "svg")}
    tables = {"table.tex", "table.csv", "table.json", "runs.csv", "time_to_error.csv", "time_to_beat.csv"}
    assert names == {"report.md"} | tables | pictures
    assert {path.relative_to(out).as_posix() for path in report.files} == names


def test_rows_and_scenes_come_as_asked_for_then_by_name(report: Report) -> None:
    assert report.findings.rows == ("ours", "later", "none", "oracle_*")
    assert report.findings.scenes == ("ship", "hat")


def test_the_report_says_where_its_runs_come_from(tmp_path: Path, write_run: Callable[..., Path]) -> None:
    for seed, commit in enumerate(("abc", "abc", "def")):
        write_run("ours", "hat", seed, environment={"commit": commit, "cpu": "Abacus 2", "threads": 1})
    write_run("ours", "hat", 3)
    report = write_report(tmp_path / "runs", tmp_path / "out")
    notes = "- 2 runs of commit abc on Abacus 2\n- 1 run of commit def on Abacus 2\n"
    assert notes in (tmp_path / "out" / "report.md").read_text()
    with (tmp_path / "out" / "runs.csv").open(newline="") as file:
        assert [(line["commit"], line["cpu"]) for line in csv.DictReader(file)] == [
            *[("abc", "Abacus 2")] * 2, ("def", "Abacus 2"), ("", "")
        ]  # fmt: skip
    assert len(report.findings.notes) == 2


def test_json_holds_the_numbers(out: Path) -> None:
    data = json.loads((out / "table.json").read_text())
    ours = next(line for line in data["overall"] if line["row"] == "ours")
    assert ours["values"]["albedo.psnr"]["mean"] == (20.5 + 24.5) / 2
    assert ours["values"]["albedo.psnr"]["half_width"] > 0
    assert (ours["failed"], ours["runs"]) == (1, 5)
    assert data["protocol"] == "paper-v1"
    assert data["differences"]["rows"]["ours"]["albedo.psnr"] == {"mean": 4.5, "half_width": 0.0, "scenes": 2}
    assert data["failures"][0] == "ours, hat, seed 2: loss is not finite at step 3"
    assert "torn" in data["failures"][1]
    assert "left out, scored under paper-v1 (lpips.net=vgg) and not paper-v1" in data["notes"][0]
    assert [claim["outcome"] for claim in data["claims"]] == ["undecided", "undecided"]
    assert data["claims"][0]["advantage"] == {"mean": 4.0, "half_width": None, "scenes": 2}


def test_markdown_says_what_a_reader_needs(out: Path) -> None:
    lines = (out / "report.md").read_text().splitlines()
    tables = [line for line in lines if line.startswith("|")]
    assert len({line.count("|") for line in tables[:6]}) == 1  # header, rule and four rows of equal width
    assert tables[2].startswith("| ours | **22.50 ± ")
    assert tables[2].endswith("| 50.0 | 1024 MiB | 1/5 |")
    assert tables[3].startswith("| later | – |")
    assert tables[4].startswith("| none | 18.00 |")
    assert tables[5].startswith("| oracle\\_\\* † | 40.00 |")  # escaped, marked, and not bold though the highest
    assert any(line.startswith("### The paper's own figures") for line in lines)
    assert "![ship](curves/ship.png)" in lines
    assert "| Albedo PSNR ≥ 15 | 5.0 s | 5.0 s | 5.0 s |" in lines
    assert "| hat | Relighting PSNR | 16.00 | 5.0 s | 5.0 s |" in lines  # when ours and the oracle are where none is best
    assert "| ours above none | Albedo PSNR ↑ | 4.00 | undecided |" in lines  # none has one seed
    assert "| later above ours | Roughness MSE ↓ | – | undecided |" in lines


def test_csv_reads_back(out: Path) -> None:
    with (out / "table.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    values = {(line["scene"], line["row"]): line for line in lines}
    assert float(values["hat", "none"]["albedo_psnr"]) == 16.0
    assert values["mean over scenes", "later"]["albedo_psnr"] == ""
    assert float(values["the paper's scenes", "Ours"]["relighting_psnr"]) == 28.9721
    with (out / "time_to_error.csv").open(newline="") as file:
        times = {(line["row"], line["scene"], line["metric"], line["level"]): line for line in csv.DictReader(file)}
    assert times["ours", "hat", "albedo.psnr", "15.0"]["seconds"] == "5.0"
    assert times["ours", "hat", "albedo.psnr", "30.0"]["seconds"] == "never"
    with (out / "time_to_beat.csv").open(newline="") as file:
        assert {(line["row"], line["level"], line["seconds"]) for line in csv.DictReader(file)} == {
            ("ours", "16.0", "5.0"), ("oracle_*", "16.0", "5.0")
        }  # fmt: skip


def test_the_runs_give_the_means_of_the_table(out: Path) -> None:
    with (out / "runs.csv").open(newline="") as file:
        runs = [line for line in csv.DictReader(file) if line["row"] == "ours"]
    finished = [line for line in runs if not line["problem"]]
    assert [(line["scene"], line["seed"], line["problem"]) for line in runs if line["problem"]] == [
        ("hat", "2", "loss is not finite at step 3")
    ]
    means = {
        scene: [float(line["albedo_psnr"]) for line in finished if line["scene"] == scene] for scene in ("hat", "ship")
    }
    assert means == {"hat": [20.0, 21.0], "ship": [24.0, 25.0]}
    assert {float(line["seconds"]) for line in finished} == {50.0}


def test_latex_has_the_papers_layout(out: Path) -> None:
    text = (out / "table.tex").read_text()
    tables = text.split("\\begin{table*}")[1:]
    assert len(tables) == 3  # overall and two scenes
    assert ["InvRender" in table for table in tables] == [True, False, False]
    overall = tables[0].splitlines()
    columns = (
        next(line for line in overall if line.startswith("\\begin{tabular}")).count("r", len("\\begin{tabular}")) + 1
    )
    body = [line for line in overall if line.endswith("\\\\") and "multicolumn" not in line]
    assert len(body) == 1 + 4 + 13
    assert {line.count(" & ") + 1 for line in body} == {columns} == {17}
    assert "PSNR$\\uparrow$ & SSIM$\\uparrow$ & LPIPS$\\downarrow$" in text
    assert "\\textbf{22.50\\,$\\pm$\\," in tables[0]
    assert "oracle\\_*$^\\dagger$ & 40.00" in tables[0]
    assert "\\textbf{33.12}" in tables[0]  # TensoIR's view synthesis, bold in the paper too
    assert text.count("\\begin{") == text.count("\\end{") == 6
    assert text.count("{") == text.count("}")


def test_latex_escapes_every_special_character() -> None:
    assert escape("a_b%#&{}$~^\\") == r"a\_b\%\#\&\{\}\$\textasciitilde{}\textasciicircum{}\textbackslash{}"


def test_the_papers_bold_figures_are_the_papers() -> None:
    rows = paper_rows()
    assert len(rows) == 13
    best = [best_paper_methods(rows, metric) for metric in METRICS]
    ours, guided_less = {"Ours"}, {"Ours w/o albedo"}
    assert best == [
        *[ours] * 3,
        ours,
        {"TensoIR"},
        ours,
        {"TensoIR"},
        *[{"NvDiffrec"}] * 2,
        ours,
        ours,
        guided_less,
        ours,
    ]


def test_the_shipped_figures_equal_the_source() -> None:
    source = ROOT.parent / "shared" / "paper" / "table1.csv"
    if not source.is_file():
        pytest.skip("needs ../shared/paper/table1.csv")
    assert (ROOT / "ia_bench" / "report" / "paper_table1.csv").read_text() == source.read_text()


def test_a_list_of_folders_counts_the_ones_that_never_finished(write_run: Write, tmp_path: Path) -> None:
    done = write_run("ours", "hat")
    report = write_report([done, tmp_path / "killed"], tmp_path / "out")
    assert len(report.findings.failures) == 1
    assert "killed" in report.findings.failures[0]


def test_a_killed_run_counts_as_a_failure_of_its_row(write_run: Write, tmp_path: Path) -> None:
    cells = {write_run("ours", "hat"): ("ours", "hat", 0), tmp_path / "killed": ("ours", "ship", 0)}
    overall = write_report(cells, tmp_path / "out").findings.results.overall
    assert (overall.lines[0].failed, overall.lines[0].runs, overall.scenes) == (1, 2, 2)


def test_only_failures_still_make_a_report(write_run: Write, tmp_path: Path) -> None:
    write_run("ours", "hat", status="failed", error="no memory")
    report = write_report(tmp_path / "runs", tmp_path / "out")
    assert report.findings.failures == ("ours, hat, seed 0: no memory",)
    assert "| ours | – |" in (tmp_path / "out" / "report.md").read_text()


def test_each_reason_of_a_null_is_told_once(write_run: Write, tmp_path: Path) -> None:
    for scene in ("hat", "ship"):
        write_run("ours", scene, psnr=None, reasons={"albedo.psnr": "identical", "relighting.psnr": "identical"})
    notes = write_report(tmp_path / "runs", tmp_path / "out").findings.notes
    assert notes[0] == "albedo.psnr, relighting.psnr undefined in ours, hat, seed 0; ours, ship, seed 0: identical"
    assert notes[1].endswith(": no reason given")


def test_what_cannot_be_reported_is_an_error(write_run: Write, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="expected at least one run folder with a metrics.json, found none"):
        write_report(tmp_path, tmp_path / "out")
    write_run("ours", "hat")
    with pytest.raises(ValueError, match="reference: expected one of the rows ours, found none"):
        write_report(tmp_path / "runs", tmp_path / "out", reference="none")


def test_a_scene_with_a_slash_gets_a_file_of_its_own(write_run: Write, tmp_path: Path) -> None:
    write_run("ours", "my/hat", curve=CURVE)
    write_report(tmp_path / "runs", tmp_path / "out")
    assert (tmp_path / "out" / "curves" / "my_hat.svg").is_file()


def test_the_report_needs_no_trainer_no_prior_and_no_matplotlib_to_be_imported() -> None:
    code = (
        "import sys, ia_bench.report.write\n"
        "print([n for n in sys.modules if n.startswith(('ia_bench.fit', 'ia_bench.priors', 'torch', 'matplotlib'))])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.strip() == "[]"
