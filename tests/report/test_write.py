"""The whole report from run folders: every format, the paper's block, failures, foreign protocols, independence."""

import math
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from scored_runs import lines_of, scored
from spoils import edited

from ia_bench.common.errors import InputError
from ia_bench.report.collect import NOT_SCORED, Collection, as_table
from ia_bench.report.findings import analyse
from ia_bench.report.table import Printed, left_out, paper_rows, paper_table, parts, results_table
from ia_bench.report.write import Report, pipe_table, tex, write_report
from ia_bench.runs.folder import find_run_folders
from ia_bench.runs.table import Claim, Row, Table
from ia_bench.scores.metrics import MEASURED

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
    write_run("ours", "hat", 3, psnr=99.0, protocol="paper-v1 (lpips.net=vgg)", protocol_description={})
    (root / "runs" / "torn").mkdir()
    (root / "runs" / "torn" / "metrics.json").write_text("{")
    claims = [Claim("ours", "none", ["albedo.psnr"]), Claim("later", "ours", ["roughness.mse"])]
    folders = find_run_folders(root / "runs")
    table = Table(["ship"], rows=[Row("ours", []), Row("later", [])], reference="none", claims=claims)
    return write_report(folders, root / "out", table)


@pytest.fixture(scope="module")
def out(report: Report) -> Path:
    return report.files[0].parent


def test_every_file_is_written_and_nothing_partial_is_left(report: Report, out: Path) -> None:
    names = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    pictures = {f"curves/{scene}.{kind}" for scene in ("hat", "ship") for kind in ("png", "svg")}
    tables = {"table.tex", *(f"{name}.csv" for name in ("table", "runs", "differences", "claims", "seconds"))}
    assert names == {"report.md", "pareto.png", "pareto.svg"} | tables | pictures
    assert {path.relative_to(out).as_posix() for path in report.files} == names


def test_rows_stand_beside_the_papers_and_beside_the_reference_renderer(tmp_path: Path, write_run: Callable[..., Path]) -> None:
    whole = {f"{name}_whole_image": {"psnr": 24.5} for name in ("albedo", "aligned_albedo", "view_synthesis", "relighting")}
    redrawn = whole | {"view_synthesis_reference": {"psnr": 17.0, "ssim": 0.8}, "relighting_reference": {"psnr": 16.0}}
    for seed in (0, 1):
        write_run("split sums", "hat", seed, psnr=20.0 + seed, variants=redrawn)
    write_run("ours", "hat")
    write_report(find_run_folders(tmp_path / "runs"), tmp_path / "out", Table(rows=[Row("split sums", [], paper="NvDiffrec*")]))
    latex = (tmp_path / "out" / "table.tex").read_text()
    assert "\\textbf{33.12}" in latex  # TensoIR's view synthesis, bold in the paper too
    paper = lines_of(tmp_path / "out" / "table.csv", "scene", "row")["the paper's scenes", "Ours"]
    assert float(paper["relighting_psnr"]) == 28.9721
    tables = (tmp_path / "out" / "report.md").read_text().partition("### The paper's own figures")[0].partition("### Rows with")[2]
    own, _, beside = tables.partition("### Rows beside")
    assert "| split sums | 20.50 ± 6.35 | 17.00 ± 0.00 |" in own
    assert "| ours |" not in own + beside
    assert "| split sums | 20.50 ± 6.35 | 24.50 ± 0.00 |" in (tmp_path / "out" / "report.md").read_text()
    assert r"| split sums | NvDiffrec\* | 20.50 / 24.50 (14.52) |" in beside


def test_a_mean_over_fewer_scenes_says_so_wherever_it_stands(tmp_path: Path, write_run: Write) -> None:
    folders = [write_run(row, scene) for row, scene in (("ours", "hat"), ("none", "hat"), ("none", "ship"))]
    table = Table(rows=[Row("ours", [], paper="Ours")], claims=[Claim("ours", "none")])
    write_report(folders, tmp_path, table)
    text = (tmp_path / "report.md").read_text()
    assert "| 50.0 (1/2) | 1024 MiB |" in text, "seconds"
    assert "| ours | Ours | 20.00 (1/2) / – (" in text, "beside the paper's"
    assert "With our small prior, on our own scenes, not with those of the paper: 0 reproduced" in text, "a row of the paper's"


def test_a_row_that_the_paper_has_not_is_named(tmp_path: Path, write_run: Callable[..., Path]) -> None:
    write_run("ours", "hat")
    with pytest.raises(InputError, match=r"rows: ours: paper: expected a row .* found NeRF"):
        write_report(find_run_folders(tmp_path / "runs"), tmp_path / "out", Table(rows=[Row("ours", [], paper="NeRF")]))
    assert not (tmp_path / "out").exists()


def test_csv_holds_the_numbers(report: Report, out: Path) -> None:
    ours = lines_of(out / "table.csv", "scene", "row")["mean over scenes", "ours"]
    assert float(ours["albedo_psnr"]) == (20.5 + 24.5) / 2
    assert float(ours["albedo_psnr_half_width"]) > 0
    assert (ours["failed"], ours["runs"]) == ("1", "5")
    differences = lines_of(out / "differences.csv", "row", "metric", "scene")
    mean = differences["ours", "albedo.psnr", "mean over scenes"]
    assert (mean["difference"], mean["half_width_over_seeds"], mean["half_width_over_scenes"]) == ("4.0", "", "0.0")
    assert (mean["pairs"], mean["carried_by"], mean["reference"]) == ("2", "", "none")  # of the seed that both rows have
    claims = lines_of(out / "claims.csv", "better", "scene")
    assert (claims["ours", "hat"]["difference"], claims["ours", "mean over scenes"]["outcome"]) == ("4.0", "reproduced")
    assert claims["later", "mean over scenes"]["difference"] == ""


def test_failures_and_what_was_left_out_are_named(report: Report, out: Path) -> None:
    assert report.findings.failures == ["ours, hat, seed 2: loss is not finite at step 3"]
    notes = report.findings.notes
    assert "left out, scored under paper-v1 (lpips.net=vgg) and not paper-v1 (lpips.net=alex)" in notes[0]
    assert "left out, no record of a run" in notes[1]
    assert "torn" in notes[1]
    text = (out / "report.md").read_text()
    assert "Protocol paper-v1 (lpips.net=alex). 9 runs, 1 failed." in text
    assert "- ours, hat, seed 2: loss is not finite at step 3\n" in text


def test_the_protocol_of_most_finished_runs_is_kept() -> None:
    """Of a runs.csv failed runs have one as well."""
    lost = [scored("ours", "hat", seed, None, protocol="a", problem="no") for seed in (1, 2, 3)]
    runs = [
        *lost,
        scored("ours", "hat", 0, 20.0, protocol="a"),
        *(scored("none", "hat", seed, 20.0, protocol="b") for seed in (0, 1)),
    ]
    assert analyse(Collection(as_table(runs))).protocol == "b"


def test_markdown_says_what_a_reader_needs(out: Path) -> None:
    lines = (out / "report.md").read_text().splitlines()
    tables = [line for line in lines if line.startswith("|")]
    assert len({line.count("|") for line in tables[:6]}) == 1  # header, rule and four rows of equal width
    assert tables[2].startswith("| ours | **22.50 ± 1.52 / 25.41** | ")  # the best, by the same in both scenes
    assert tables[2].endswith("| 50.0 | 1024 MiB | 1/5 |")
    assert tables[3].startswith("| later | – |")
    assert tables[4].startswith("| none | 18.00 ± – / 25.41 |")
    assert tables[5].startswith("| oracle\\_\\* † | 40.00 ± – / 0.00 |")  # escaped, marked, and not bold though the highest
    assert "| ours | +4.00 ± – / 0.00 / 0.00 | +4.00 ± – / 0.00 / 0.00 |" in (out / "report.md").read_text()
    assert "| ours | +0.0000 ± – / 0.0000 / 0.0000 |" in (out / "report.md").read_text()
    assert not any(line.startswith("### The paper's own figures") for line in lines), "no row stands for one of the paper's"
    assert "![ship](curves/ship.png)" in lines
    assert (
        "| ours above none | Albedo PSNR ↑ | +4.00 ± – / 0.00 / 0.00 | reproduced | – | < 0.0001 | +4.00 | +4.00 |".replace(
            "<", r"\<"
        )
        in lines
    )
    assert "| later above ours | Roughness MSE ↓ | – | undecided | – | – | – | – |" in lines


def test_latex_has_the_papers_layout(out: Path) -> None:
    text = (out / "table.tex").read_text()
    check_latex(text)
    assert '"' not in text, "which LaTeX prints as a closing quotation mark"
    tables = text.split("\\begin{table*}")[1:]
    assert len(tables) == 6  # as in the paper, with intervals, at equal seconds, claims, two scenes
    groups = ("Albedo", "Aligned Albedo", "View Synthesis", "Relighting")
    header = "".join(rf" & \multicolumn{{3}}{{c}}{{{name}}}" for name in groups) + r" & \multicolumn{1}{c}{Roughness} \\"
    assert header in tables[0].splitlines()
    assert (
        "Method" + r" & PSNR$\uparrow$ & SSIM$\uparrow$ & LPIPS$\downarrow$" * 4 + r" & MSE$\downarrow$ \\"
        in tables[0].splitlines()
    )
    assert r"ours & \textbf{22.50} & 0.9000" in tables[0]
    assert "oracle\\_*$^\\dagger$ & 40.00" in tables[0]
    assert r"ours & \textbf{22.50\,$\pm$\,1.52 / 25.41} &" in tables[1]
    assert "caption{1 reproduced, 0 not reproduced" in tables[3]


def check_latex(text: str) -> None:
    """What can be told without LaTeX: braces, environments, known commands, and as many cells in a row as there are columns."""
    plain = re.sub(r"\\[\\{}&%$#_]", "", text)
    assert plain.count("{") == plain.count("}")
    assert plain.count("$") % 2 == 0
    assert not re.search(r"[<>#~]", re.sub(r"\$[^$]*\$", "", plain)), "or another letter is printed"
    assert text.isascii()
    known = {"begin", "end", "centering", "caption", "resizebox", "linewidth", "toprule", "midrule", "bottomrule", "cmidrule"}
    known |= {"multicolumn", "emph", "textbf", "dagger", "ddagger", "pm", "uparrow", "downarrow", "usepackage"}
    assert set(re.findall(r"\\([a-zA-Z]+)", text)) <= known
    opened = list[str]()
    for kind, name in re.findall(r"\\(begin|end)\{(.*?)\}", text):
        assert (opened.append(name) if kind == "begin" else opened.pop()) in (None, name)
    assert not opened
    for columns, body in re.findall(r"\\begin\{tabular\}\{(lr*)\}(.*?)\\end\{tabular\}", text, re.DOTALL):
        assert len(rows := re.findall(r"^(.*) \\\\$", body, re.MULTILINE)) > 1
        for row in rows:
            spans = sum(int(wide) - 1 for wide in re.findall(r"\\multicolumn\{(\d+)\}", row))
            assert len(re.findall(r"(?<!\\)&", row)) + 1 + spans == len(columns), row


def test_latex_and_markdown_escape_every_special_character() -> None:
    assert tex("a_b%#&{}$~^\\") == r"a\_b\%\#\&\{\}\$\textasciitilde{}\textasciicircum{}\textbackslash{}"
    assert tex("a|b") == "a$|$b", "which is a dash in LaTeX's first fonts"
    assert (tex("*ours"), tex("[7] theirs")) == ("{}*ours", "{}[7] theirs"), "behind a line's end they would be options of it"
    assert pipe_table(Printed(["Row"], [["$a_b$ | <i>*c*</i>"]])).splitlines()[-1] == r"| \$a\_b\$ \| \<i\>\*c\*\</i\> |"
    assert pipe_table(Printed(["Row"], [["~~less~~"]])).splitlines()[-1] == r"| \~\~less\~\~ |", "which would be struck through"


def test_the_papers_bold_figures_are_the_papers() -> None:
    rows = paper_rows()
    assert len(rows) == 13
    methods, *figures = zip(*paper_table(rows).body, strict=True)
    best = [{method for method, one in zip(methods, column, strict=True) if one.best} for column in figures]
    ours, guided_less = {"Ours"}, {"Ours w/o albedo"}
    assert best == [*[ours] * 3, ours, {"TensoIR"}, ours, {"TensoIR"}, *[{"NvDiffrec"}] * 2, ours, ours, guided_less, ours]


def test_each_reason_of_a_null_is_one_footnote_wherever_it_holds(write_run: Write, tmp_path: Path) -> None:
    """A scene without such truth and a method that cannot predict are two reasons, and stand behind their own dashes."""
    for scene in ("hat", "ship"):
        cannot = dict.fromkeys(
            (f"{name}.psnr" for name in ("aligned_albedo", "view_synthesis", "relighting")), "the method cannot predict it"
        )
        reasons = {"albedo.psnr": "the scene has no such truth", **cannot}
        folder = write_run("ours", scene, psnr=None, reasons=reasons)
    edited("metrics.json", lambda of_ship: of_ship["metrics"]["roughness"].update(mse=None))(folder)
    edited("metrics.json", lambda of_ship: of_ship["reasons"].update({"roughness.mse": "no true roughness"}))(folder)
    report = write_report(find_run_folders(tmp_path / "runs"), tmp_path / "out")
    runs = "ours, hat, seed 0; ours, ship, seed 0"
    assert report.findings.undefined == {
        "the scene has no such truth": f"albedo.psnr in {runs}",
        "the method cannot predict it": f"aligned_albedo.psnr, view_synthesis.psnr, relighting.psnr in {runs}",
        "no true roughness": "roughness.mse in ours, ship, seed 0",
    }
    text = (tmp_path / "out" / "report.md").read_text()
    assert "| ours | 0.9000 | 0.1000 | 0.9000 | 0.1000 |" in text, "columns that no run has are left out"
    assert "Left out, for no run has it: Albedo PSNR ↑: the scene has no such truth." in text
    cannot_be = "Aligned albedo PSNR ↑, View synthesis PSNR ↑, Relighting PSNR ↑"
    assert f"Left out, for no run has it: {cannot_be}: the method cannot predict it." in text
    overall, hat, ship = text.split("\n## ")[1:4]
    assert "| ours | 0.0500 (1/2)[^3] |" in overall, "one scene has it"
    assert "Roughness MSE ↓: no true roughness" not in overall + hat
    assert "Left out, for no run has it: Roughness MSE ↓: no true roughness" in ship
    assert f"\n[^1]: the scene has no such truth (albedo.psnr in {runs})\n" in text
    assert "\n[^2]: the method cannot predict it (" in text
    latex = (tmp_path / "out" / "table.tex").read_text()
    assert "ours & --$^{1}$ &" in latex
    assert "$^{2}$ the method cannot predict it." in latex
    (told,) = {line["reason"] for line in lines_of(tmp_path / "out" / "runs.csv", "scene").values() if line["scene"] == "hat"}
    assert told.startswith("albedo.psnr: the scene has no such truth; aligned_albedo.psnr, view_synthesis.psnr, ")


# ---- how the runs were made ----
def test_presets_threads_commits_and_changed_code_that_mix_stand_first(write_run: Write, tmp_path: Path) -> None:
    made = [("quick", 1, "abc"), ("quick", 1, "abc"), ("smoke", 2, "def+changes")]
    for seed, (preset, threads, commit) in enumerate(made):
        machine = {"commit": commit, "cpu": "Abacus 2", "threads": threads}
        write_run("ours" if seed < 2 else "fast", "hat", seed, preset=preset, environment=machine)
    found = write_report(sorted((tmp_path / "runs").iterdir()), tmp_path / "out").findings
    assert found.warnings == [
        "Runs of different presets stand side by side: quick (2), smoke (1).",
        "Runs of different numbers of threads stand side by side: 1 (2), 2 (1).",
        "Runs of different commits stand side by side: abc (2), def+changes (1).",
        "1 of 3 runs were made by changed code, not by that of a commit.",
        "1 of 3 runs are of preset=smoke, which shows that everything works, and how well nothing does.",
    ]
    assert found.origins == [("2", "quick", "1", "abc", "Abacus 2", "ours"), ("1", "smoke", "2", "def+changes", "Abacus 2", "fast")]
    text = (tmp_path / "out" / "report.md").read_text()
    assert text.index("different presets") < text.index("## Mean over")
    assert "| 2 | quick | 1 | abc | Abacus 2 | ours |\n" in text
    assert text.splitlines()[2].startswith("**Runs of different presets stand side by side"), "the first line"
    header = next(line for line in text.splitlines() if line.startswith("| Row"))
    assert header.endswith("| Failed | Preset | Threads | Commit |")
    assert "| 0/2 | quick | 1 | abc |\n" in text
    assert "different presets" in (tmp_path / "out" / "table.tex").read_text().partition("\\begin{tabular}")[0]
    fast = lines_of(tmp_path / "out" / "table.csv", "scene", "row")["mean over scenes", "fast"]
    assert (fast["preset"], fast["threads"], fast["commit"]) == ("smoke", "2", "def+changes")


def test_what_is_alike_for_all_runs_is_said_once(write_run: Write, tmp_path: Path) -> None:
    """Commits are cut to 12 digits: one record has more of the same."""
    commit = "0123456789abcdef"
    for seed in (0, 1):
        write_run("ours", "hat", seed, preset="quick", environment={"commit": commit[: 16 if seed else 12], "threads": 1})
    write_report(sorted((tmp_path / "runs").iterdir()), tmp_path / "out")
    text = (tmp_path / "out" / "report.md").read_text()
    assert "2 runs, 0 failed. Every run: preset quick, threads 1, commit 0123456789ab.\n" in text
    assert "stand side by side" not in text
    assert "| Failed |\n" in text


def test_the_light_stands_in_the_main_table_and_every_new_group_in_one_of_its_own() -> None:
    done = as_table([scored("ours", "hat", seed, 1.0 + seed) for seed in (0, 1)])
    found = dict(parts(analyse(Collection(done)).overall))
    assert [metric.key for metric in found[""]][-3:] == ["roughness.mse", "light.psnr", "log_light.rmse"]
    assert [*found] == ["", "SSIM and LPIPS", "Metallic", "Where the error sits"]
    split = found["Where the error sits"]
    printed = results_table(analyse(Collection(done)).overall, {}, split)
    assert printed.header[1:] == [f"{metric.label} ↓" for metric in split]
    former = done.assign(**{metric.column: math.nan for metric in [*split, *found["Metallic"], *found[""][-2:]]}, reasons=[{}, {}])
    former["reasons"] = [{metric.key: NOT_SCORED for metric in MEASURED}] * 2
    findings = analyse(Collection(former))
    assert [*dict(parts(findings.overall))] == ["", "SSIM and LPIPS"]
    assert (findings.footnotes, left_out(findings.overall)) == ({}, []), "nobody has to know of what is newer than all records"


def test_a_scene_that_was_not_run_is_not_one_where_every_run_failed() -> None:
    runs = as_table([scored("ours", "hat", 0, None, problem="no")])
    hat, ship = analyse(Collection(runs), Table(scenes=["hat", "ship"])).blocks
    assert [left_out(block)[0].rpartition(": ")[2] for block in (hat, ship)] == ["every run failed", "no run is here"]


def test_runs_that_were_made_alike_are_compared_by_their_seconds_too() -> None:
    alike = {"preset": "quick", "threads": 1, "commit": "abc", "clean": True, "cpu": "Abacus 2"}
    runs = as_table([scored(row, "hat", seed, 1.0, **alike, load=1.0) for row in ("none", "ours") for seed in (0, 1)])
    found = analyse(Collection(runs))
    assert (found.warnings, found.unranked_seconds) == ([], "")
    assert [(one[0], one[-1]) for one in found.origins] == [("4", "all")]
    assert analyse(Collection(runs.assign(load=1.1))).unranked_seconds == ""
    busy = analyse(Collection(runs.assign(load=[1.1, 1.1, 1.1, 2.0])))
    assert busy.warnings == ["1 of 4 runs ran beside so much else that their seconds are too many: do not compare them."]
    for changes, why in (
        ({"cpu": ["a", "a", "a", "b"]}, "runs are of different processors"),
        (
            {"threads": [1, 1, 2, None]},
            "runs are of different numbers of threads; nobody knows the number of threads of 1 of 4 runs",
        ),
        ({"load": [1.1, 1.1, 1.1, 2.0]}, "1 of 4 runs ran beside too much else"),
        ({"load": [math.nan, 1.0, math.nan, 1.0]}, "nobody knows what else ran beside 2 of 4 runs, of which no load was recorded"),
        ({"declared": ["yes", None, None, None], "load": [math.nan, 1, 1, 1]}, "1 of 4 runs took what somebody says of them"),
    ):
        assert analyse(Collection(runs.assign(**changes))).unranked_seconds == f"Seconds rank nothing: {why}."


def test_a_report_says_that_no_load_was_recorded(tmp_path: Path) -> None:
    """Of one machine that was idle nothing is said; of one of which nobody knows it, in the report."""
    alike = {"preset": "quick", "threads": 1, "commit": "abc", "clean": True, "cpu": "Abacus 2"}
    for load, told in (
        (1.0, []),
        (None, ["Seconds rank nothing: nobody knows what else ran beside 1 of 1 runs, of which no load was recorded."]),
    ):
        write_report([], tmp_path, Table(), [scored("none", "hat", 0, 20.0, **alike, load=load)])
        lines = (tmp_path / "report.md").read_text().splitlines()
        assert [line for line in lines if "rank nothing" in line] == told


def test_the_shipped_figures_equal_the_source() -> None:
    source = ROOT.parent / "shared" / "paper" / "table1.csv"
    if not source.is_file():
        pytest.skip("needs ../shared/paper/table1.csv")
    assert (ROOT / "ia_bench" / "report" / "paper_table1.csv").read_text() == source.read_text()


def test_a_killed_run_counts_as_a_failure_of_its_row(write_run: Write, tmp_path: Path) -> None:
    cells = {write_run("ours", "hat"): ("ours", "hat", 0), tmp_path / "killed": ("ours", "ship", 0)}
    overall = write_report(cells, tmp_path / "out").findings.overall
    assert (overall.lines[0].failed, overall.lines[0].runs, overall.scenes) == (1, 2, 2)
