"""The README's table against docs/results/table.csv and seconds.csv. Its failure prints the row as it should stand there.

And what the map says of the code that made its runs, against these runs.
"""

import csv
import re
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SHOWN = [
    "none", "none, four times the steps", "diffusion, targets", "diffusion, kernel", "parsimony", "combined", "oracle",
]  # fmt: skip


def lines_of(name: str, column: str, value: str) -> dict[str, dict[str, str]]:
    """By its row, every line of a published table that has ``value`` in one of its columns."""
    with (ROOT / "docs" / "results" / name).open(encoding="utf-8") as file:
        return {line["row"]: line for line in csv.DictReader(file) if line[column] == value}


def test_the_readme_shows_the_published_table() -> None:
    """CPU time, mean scores, and what the row gains in equal time, which of the reference and its curve is nothing."""
    rows, seconds = lines_of("table.csv", "scene", "mean over scenes"), lines_of("seconds.csv", "metric", "aligned_albedo.psnr")
    lines = [
        [part.strip() for part in line.strip("|\n").split("|")]
        for line in (ROOT / "README.md").open(encoding="utf-8")
        if line[0] == "|"
    ]
    shown = {cells[0].removesuffix(" †"): cells for cells in lines if cells[0].removesuffix(" †") in rows}
    assert list(shown) == SHOWN
    for name, cells in shown.items():
        row, time = rows[name], seconds[name]
        gain = f"{float(time['equal_seconds']):+.1f} ± {float(time['equal_seconds_half_width_over_scenes']):.1f}"
        assert cells[0].endswith("†") == (row["sees_truth"] == "True"), name
        expected = [f"{float(value):.1f}" for value in (time["cost"], row["aligned_albedo_psnr"], row["relighting_psnr"])]
        assert cells[2:] == [*expected, "–" if name.startswith("none") else gain], f"README.md, row {name}"


def test_the_map_and_its_runs_say_alike_what_code_made_them() -> None:
    """A runs.csv without the column "clean" says it by how a commit ends; without that end, changed code passes for a commit's."""
    folder = ROOT / "docs" / "results" / "value"
    told = (folder / "value.md").read_text(encoding="utf-8")
    with (folder / "runs.csv").open(encoding="utf-8") as file:
        commits = Counter(line["commit"] for line in csv.DictReader(file))
    named = re.findall(r"(\w+\+changes) \((\d+)\)", told)
    assert named
    assert all(commits[commit] >= int(count) for commit, count in named), "the map is of some of the runs"
    changed = sum(count for commit, count in commits.items() if commit.endswith("+changes"))
    assert changed >= int(re.search(r"(\d+) of \1 runs were made by changed code", told)[1])
