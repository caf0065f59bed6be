"""Tables that photograph their scenes in several ways: which cells they have, and what is wrong with a capture."""

from __future__ import annotations

from pathlib import Path

import pytest

from ia_bench.capture.settings import CaptureSettings
from ia_bench.common.errors import InputError
from ia_bench.runs import table as module
from ia_bench.runs.cells import TableRequest, make_cells
from ia_bench.runs.table import load_table


def test_every_row_is_run_with_every_capture_unless_it_says_with_which(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "conf_folder", lambda: tmp_path)
    (tmp_path / "table").mkdir()
    rows = '[{name: a, overrides: [prior=none]}, {name: b, overrides: [prior=oracle], captures: [""]}]'
    captures = "[{}, {views: 8, radiometry: ldr}, {faults: {mask_growth: -2}}]"
    (tmp_path / "table" / "t.yaml").write_text(f"scenes: [hat]\nreference: a\nrows: {rows}\ncaptures: {captures}\n")
    table = load_table("t")
    assert [row.name for row in table.crossed_rows] == ["a", "b", "a, 8 views, LDR", "a, mask growth -2.0"]
    assert table.compared is None, "rows of different captures do not compare"
    monkeypatch.undo()
    cells = make_cells(table, TableRequest(overrides=("device=cpu",)), 1, Path("results/t"))
    capture = {cell.row.name: cell.config.capture for cell in cells}
    assert (capture["a, 8 views, LDR"].views, capture["a, 8 views, LDR"].radiometry) == (8, "ldr")
    assert capture["a, mask growth -2.0"].faults.mask_growth == -2
    assert capture["a"] == capture["b"] == CaptureSettings()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("captures: [{vews: 8}]", "unknown setting 'captures.vews'; did you mean 'captures.views'?"),
        ("captures: [{views: 0}]", "captures.views: "),
        ("captures: [{views: 8}, {views: 8}]", "rows: expected different names, found a, 8 views, a, 8 views"),
        ("captures: [{views: 8}]\nrows: [{name: a, overrides: [], captures: [8 vews]}]", "unknown capture '8 vews'"),
    ],
)
def test_wrong_captures_are_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, said: str) -> None:
    monkeypatch.setattr(module, "conf_folder", lambda: tmp_path)
    (tmp_path / "table").mkdir()
    rows = "" if "rows" in text else "rows: [{name: a, overrides: []}]\n"
    (tmp_path / "table" / "t.yaml").write_text(f"scenes: [hat]\n{rows}{text}\n")
    with pytest.raises(InputError) as caught:
        load_table("t")
    assert str(tmp_path / "table" / "t.yaml") in str(caught.value)
    assert said in str(caught.value)
