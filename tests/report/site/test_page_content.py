"""What the page says, against the run folders that it is made from; no browser is needed."""

import html
import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from scored_runs import put_setup, scored

from ia_bench.report.collect import Collection, as_table, collect
from ia_bench.report.findings import MEAN, analyse
from ia_bench.report.site.page import scopes, write_page
from ia_bench.report.statistics import HOW_JUDGED
from ia_bench.report.write import write_report
from ia_bench.runs.table import Claim, Row, Table

Write = Callable[..., Path]
CURVE = "stage1,0,1,10,10,10,10,0.1\nstage1,50,5,16,16,16,16,0.05\n"


@pytest.fixture
def folders(write_run: Write) -> list[Path]:
    """Floor at 10, ceiling at 30, ``none`` at 15 and 20, ``ours`` at 20 to 27 with two seeds and one failure."""
    made = []
    for scene, ours in (("hat", 20.0), ("ship", 26.0)):
        made += [write_run("ceiling", scene, psnr=30.0, sees_truth=True), write_run("constant", scene, psnr=10.0, sees_truth=True)]
        made += [write_run("none", scene, seed, psnr=15.0 if scene == "hat" else 20.0, curve=CURVE) for seed in (0, 1)]
        made += [write_run("ours", scene, seed, psnr=ours + seed, curve=CURVE) for seed in (0, 1)]
    return [*made, write_run("ours", "hat", 2, status="failed", error="</script><b>not finite</b>")]


def page_data(page: Path) -> dict:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page.read_text(encoding="utf-8"), re.DOTALL)
    assert found
    return json.loads(found[1])


def test_bars_are_the_share_of_the_headroom(folders: list[Path]) -> None:
    tables = {block.title: lines for block, lines in scopes(analyse(collect(folders)))}
    assert list(tables) == [MEAN, "hat", "ship"]
    shares = {line.row: numbers[0].share for line, numbers in tables["hat"]}
    assert shares == {"ceiling": 100.0, "constant": 0.0, "none": 25.0, "ours": 52.5}  # (20.5 - 10) / (30 - 10)
    means = {line.row: numbers[0].share for line, numbers in tables[MEAN]}
    assert means["ours"] == pytest.approx(100 * ((20.5 + 26.5) / 2 - 10) / 20)
    few = [folder for folder in folders if folder.name != "none-ship-0" and folder.name != "none-ship-1"]
    shares = {line.row: numbers[0].share for line, numbers in scopes(analyse(collect(few)))[0][1]}
    assert (shares["none"], shares["ours"]) == (None, means["ours"]), "one of hat alone goes no way between bounds of both"


def test_bars_are_explained_where_there_are_some_and_seconds_rank_where_they_compare(write_run: Write, tmp_path: Path) -> None:
    """They do for runs of one machine that is known to have been idle."""
    rows = [write_run("ours", "hat", seed, environment={"cpu": "Abacus 2", "threads": 1}, load=1.0) for seed in (0, 1)]
    bounds = [write_run(row, "hat", environment={"cpu": "Abacus 3"}) for row in ("ceiling", "constant")]
    unknown = [write_run("ours", "hat", 2, environment={"cpu": "Abacus 2", "threads": 1})]
    alike, mixed, busy = (
        write_page(analyse(collect(folders)), "t", tmp_path / str(len(folders))).read_text(encoding="utf-8")
        for folders in (rows, rows + bounds, rows + unknown)
    )
    assert ["The bar behind a number" in text for text in (alike, mixed)] == [False, True]
    assert ['data-sort="seconds"' in text for text in (alike, mixed, busy)] == [True, False, False]
    assert ["Seconds rank nothing: runs are of different processors" in text for text in (alike, mixed, busy)] == [
        False,
        True,
        False,
    ]
    assert ["no load was recorded" in text for text in (alike, mixed, busy)] == [False, True, True]
    assert ["stand side by side" in text for text in (alike, mixed)] == [False, True]


def test_both_psnrs_and_the_light_are_on_the_page_where_a_run_has_them(write_run: Write, tmp_path: Path) -> None:
    scores = {"albedo": {"psnr": 20.0}, "light": {"psnr": 16.5}, "log_light": {"rmse": 1.1}, "albedo_error": {"low": 0.25}}
    whole = {"albedo_whole_image": {"psnr": 24.0}}
    findings = analyse(collect([write_run("ours", "hat", seed, metrics=scores, variants=whole) for seed in (0, 1)]))
    page = write_page(findings, "t", tmp_path / "page")
    text = page.read_text(encoding="utf-8")
    assert '20.00 <small>± 0.00</small><span class="whole">whole image 24.00</span>' in text
    assert [one["key"] for one in page_data(page)["metrics"]][-3:] == ["light.psnr", "log_light.rmse", "albedo_error.low"]
    heads = re.findall(r'<th scope="col"[^>]*data-key="([^"]*)"([^>]*)>', text)
    assert ("light.psnr", "") in heads, "shown at once"
    assert ("albedo_error.low", ' class="more"') in heads, "and when somebody asks for all"
    former = write_page(analyse(collect([write_run("former", "hat")])), "t", tmp_path / "former").read_text(encoding="utf-8")
    assert "light.psnr" not in former


def test_claims_stand_on_the_page_in_the_words_of_the_report(folders: list[Path], tmp_path: Path) -> None:
    """5 and 6 on hat, 6 and 7 on ship. Over seeds 4.303 * sqrt(.125), over scenes 12.706 * .5, of a new one sqrt(3) as much."""
    claims = [Claim(*pair, ["albedo.psnr"]) for pair in (("ours", "none"), ("none", "ours"))]
    made = write_report(folders, tmp_path / "out", Table(claims=claims))
    text = write_page(made.findings, "t", tmp_path / "page").read_text(encoding="utf-8")
    section = re.search(r'<section id="claims".*?</section>', text, re.DOTALL)
    assert section
    lines = [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", line) for line in re.findall(r"<tr.*?</tr>", section[0], re.DOTALL)]
    assert lines[1][:4] == ["ours above none", "Albedo PSNR ↑", "+6.00 ± 1.52 / 6.35 / 11.00", "undecided"]
    assert lines[2][:4] == ["none above ours", "Albedo PSNR ↑", "-6.00 ± 1.52 / 6.35 / 11.00", "undecided"]
    report = (tmp_path / "out" / "report.md").read_text(encoding="utf-8")
    assert all(f"| {' | '.join(line)} |" in report for line in lines)
    assert HOW_JUDGED in html.unescape(section[0])
    assert HOW_JUDGED in report
    assert "<p>0 reproduced, 0 not reproduced, 0 reproduced alone, 0 not reproduced alone, 2 undecided.</p>" in section[0]
    assert 'href="#claims"' in text


def test_the_same_runs_give_the_same_bytes_no_address_to_fetch_and_no_markup(folders: list[Path], tmp_path: Path) -> None:
    found = analyse(collect(folders))
    first, second = (write_page(found, "t", tmp_path / "page").read_bytes() for _ in range(2))
    assert first == second
    assert not re.search(rb'(?:src|href)="(?:https?:)?//', first)
    assert b"url(http" not in first
    page = write_page(found, "<i>title</i>", tmp_path / "page")
    text = page.read_text(encoding="utf-8")
    assert "<b>not finite" not in text
    assert "<i>title" not in text
    assert [run["problem"] for run in page_data(page)["runs"] if "problem" in run] == ["</script><b>not finite</b>"]


def test_a_cell_of_the_map_names_its_scenes_whatever_they_are_called(tmp_path: Path) -> None:
    scenes = ["a|b", 'it\'s "mine" & <b>']
    runs = [scored(row, scene, 0, psnr) for row, psnr in (("none", 20.0), ("ours", 21.0)) for scene in scenes]
    table = Table(rows=[Row("none", []), Row("ours", [])], reference="none", captures=[{}])
    text = write_page(analyse(Collection(as_table(runs)), table), "t", tmp_path).read_text(encoding="utf-8")
    (told, *_) = re.findall(r"data-scenes='([^']*)'", text)
    assert json.loads(html.unescape(told)) == scenes


def test_a_run_tells_its_command_and_what_many_runs_share_is_told_once(write_run: Write, tmp_path: Path) -> None:
    environment = {"cpu": "Abacus 2", "threads": 1, "packages": {"torch": "3", "numpy": None}}
    folders = [write_run("ours", "hat", seed, environment=environment, files={"a.exr": "0123456789abcdef"}) for seed in (0, 1)]
    for seed, folder in enumerate(folders):
        config = {"seed": seed, "scene": {"name": "hat"}, "fit": {"steps": 7}}
        put_setup(folder, config=config, command=f"python -m ia_bench seed={seed}")
    found = page_data(write_page(analyse(collect(folders)), "t", tmp_path / "page"))
    assert found["configurations"] == [{"fit.steps": 7}]
    assert found["machines"] == [{"cpu": "Abacus 2", "threads": 1, "packages.torch": "3", "packages.numpy": None}]
    assert [run["command"] for run in found["runs"]] == ["python -m ia_bench seed=0", "python -m ia_bench seed=1"]
    assert [run["files"] for run in found["runs"]] == [{"a.exr": "0123456789ab"}] * 2


def test_a_published_run_tells_the_command_that_made_it(tmp_path: Path) -> None:
    """And none that its row and scene would suggest: that leaves out the reader, and what every cell was given."""
    runs = as_table([scored("ours", "mug", seed, 20.0, command=(None, "prior=none reader=colmap")[seed]) for seed in (0, 1)])
    found = page_data(write_page(analyse(Collection(runs), Table(rows=[Row("ours", ["prior=none"])])), "t", tmp_path))
    assert [run.get("command") for run in found["runs"]] == [None, "ia-bench run prior=none reader=colmap"]
    assert "command" not in found["rows"][0]


def test_runs_that_were_scored_again_have_no_curve_though_their_folders_are_there(write_run: Write, tmp_path: Path) -> None:
    text = write_page(analyse(collect([write_run("ours", "hat")])), "t", tmp_path / "page").read_text(encoding="utf-8")
    assert "and a run that was scored again has none" in text
