"""What a table's file may say, which of its rows are run, and what is wrong with it, told before anything runs."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from ia_bench.capture.settings import CaptureSettings
from ia_bench.cli.table import parse
from ia_bench.common.errors import InputError
from ia_bench.runs.cells import TableRequest, make_cells
from ia_bench.runs.composition import compose
from ia_bench.runs.identity import hash_of, identity
from ia_bench.runs.table import Claim, Row, SceneEntry, Table, capture_of, crossed_name, load_table, rows_in, some_rows

TWO = "rows: [{name: a, overrides: []}, {name: b, overrides: []}]\n"
BAD_NAMES = ('""', '" "', '"a\\nb"', '"a\\0b"', "a" * 5000)


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_bad_table_file_is_named() -> None:
    for content, message in [
        ("rowes: []", r"bad\.yaml: .*rowes"),
        ("rows: [{name: a, overrides: []}, {name: a, overrides: []}]", "expected different names, found a, a"),
        ("rows: [{name: a, overrides: []}]\nreference: b", "reference: unknown row 'b'"),
        ("rows: [{name: a, overrides: []}, {name: ab, overrides: []}]\ncurve: [abc]", "curve: unknown row 'abc'"),
        ("captures: [{vews: 8}]", "unknown setting 'captures.vews'; did you mean 'captures.views'"),
        ("captures: [{views: 0}]", "captures.views: "),
        ("captures: []", "captures: expected at least one, found "),
        ("captures: [{name: on}]", "captures.name: expected text, found True"),
        ("captures: [{name: 007}]", "captures.name: expected text, found 7"),
        ("photographs: 0", "photographs: expected 1 or more, found 0"),
        (
            "rows: [{name: a, overrides: []}]\nclaims: [{better: a, worse: a, metrics: []}]",
            "metrics: expected at least one, found ",
        ),
        ("seeds: [１]", "seeds.0: expected a whole number, found '１'"),
        ("captures: [{views: 8}, {views: 8}]\nrows: [{name: a, overrides: []}]", "expected different names, found a, 8 views, a"),
        ("captures: [{views: 8}]\nrows: [{name: a, overrides: [], captures: [8 vews]}]", "unknown capture '8 vews'"),
        ("captures: [{views: 8}]\nrows: [{name: a, overrides: [], cost: {8 vews: 1}}]", "a: cost: unknown capture '8 vews'"),
        ("includes: [bad.yaml]", "includes: expected tables that do not include each other, found bad.yaml in bad.yaml"),
        ("rows: [{name: a, overrides: []}]\nclaims: [{better: a, worse: b}]", "claims: unknown row 'b'"),
        ("rows: [{name: a, overrides: []}]\nclaims: [{better: a, worse: a, metrics: [albedo]}]", "unknown metric 'albedo'"),
        *((f"rows: [{{name: {name}, overrides: []}}]", "rows.0.name: expected a name of 1 to 200 printable") for name in BAD_NAMES),
        ("scenes: [{name: a}, a]", "scenes: expected different names, found a, a"),
        ("scenes: [{name: 'a ${seed}'}]", r"bad\.yaml: scenes: expected names without \${, which .*, found a \${seed}$"),
        ("rows: [{name: 'a ${seed}', overrides: []}]", r"rows: expected names without \${, which .*, found a \${seed}$"),
        ("scenes: [{name: a, path: 3}]", "scenes.0.path: expected text"),
        ("scenes: [{name: a, raeder: colmap}]", r"unknown setting 'scenes.0.raeder'; did you mean 'scenes.0.reader'\?"),
        ("scenes: [{name: a, capture: phone}]\ncaptures: [{views: 8}]", "scenes: a: capture: expected none in a table"),
        *(
            (f"rows: [{{name: a, overrides: ['{override}']}}]", rf"rows: a: overrides: {re.escape(override)}: the table sets this")
            for override in ("seed=3", "scene=hat", "+scene.path=x", "threads=2", "row=b", "out=there", "reader=dtu", "hydra.job=1")
        ),
        ("seeds: []", "seeds: expected at least one"),
        ("seeds: [0]\nseeds: [1]", r"bad\.yaml: not valid YAML \(.* found duplicate key seeds .*line 2"),
        ("rows: [{name: a, name: b, overrides: []}]", "found duplicate key name"),
        (f"{TWO}curve: [b]", "curve: expected a reference beside it, .*, found none: b$"),
        (f"{TWO}claims: [{{better: a, worse: a}}]", "claims: expected two rows, .* in albedo.psnr, found a alone$"),
        (f"{TWO}claims: [{{better: a, worse: b}}, {{better: b, worse: a, metrics: [relighting.psnr]}}]", "found a and b 2 times$"),
        (f"{TWO}claims: [{{better: a, worse: b, metrics: [light.psnr, light.psnr]}}]", "in light.psnr, found a and b 2 times$"),
        (
            "captures: [{views: 8}, {}]\nrows: [{name: a, overrides: [capture.views=4]}]",
            "rows: a: overrides: capture.views=4: expected",
        ),
        ("rows: [", r"bad\.yaml: not valid YAML"),
        ("[1]", r"bad\.yaml: expected a YAML table, found list"),
        (bytes(range(256)), r"bad\.yaml: expected YAML as UTF-8 text"),
        (b"a: " + b"[" * 100_000, r"bad\.yaml: not valid YAML \(nested too deeply\)"),
    ]:
        Path("bad.yaml").write_bytes(content if isinstance(content, bytes) else content.encode())
        with pytest.raises(InputError, match=f"(?s){message}"):
            load_table("bad.yaml")


def test_a_file_of_ones_own_is_a_table() -> None:
    Path("mine.yaml").write_text("scenes: [hat]\nrows: [{name: a, overrides: [prior=none]}]")
    request = parse(["table=mine.yaml"])
    assert request.name == "mine"
    assert [row.name for row in request.load().rows] == ["a"]
    with pytest.raises(InputError, match=r"table=other.yaml: no such file"):
        parse(["table=other.yaml"]).load()
    Path("mine.yaml").write_text("rows: [{name: a, override: [prior=none]}]")
    with pytest.raises(InputError, match=r"mine.yaml: unknown setting 'rows.0.override'; did you mean 'rows.0.overrides'"):
        request.load()


def test_some_rows_of_a_table_are_named_with_the_commas_that_they_have() -> None:
    rows = [Row(name, ["prior=none"]) for name in ("none", "targets", "refiner", "refiner, hull", "a,b")]
    claims = [Claim("targets", "none"), Claim("refiner", "none")]
    table = Table(rows=rows, reference="none", claims=claims)
    few = some_rows(table, rows_in("none,refiner, hull,targets", table))
    assert [row.name for row in few.rows] == ["none", "targets", "refiner, hull"]
    assert (few.reference, few.claims) == ("none", claims[:1])
    assert rows_in("refiner", table) == ["refiner"]
    assert rows_in("refiner,hull,a,b,none", table) == ["refiner, hull", "a,b", "none"], "with or without blanks"
    assert [row.name for row in some_rows(table, ["none", "refiner"]).rows] == ["none", "refiner"]
    few_views = [crossed_name(name, capture_of({"views": 8}).label) for name in ("none", "targets", "refiner")]
    claims = [Claim(better, few_views[0]) for better in few_views[1:]]
    crossed = replace(table, captures=[{"views": 8}, {"views": 32}], claims=claims)
    assert some_rows(crossed, ["none", "targets"]).claims == crossed.claims[:1]
    assert some_rows(table, ["refiner"]).reference is None
    with pytest.raises(InputError, match="rows: expected every row once, found none, none"):
        rows_in("none,none", table)
    with pytest.raises(
        InputError,
        match=r"rows: unknown row 'nome'; did you mean 'none'\? There are: none, targets, refiner, 'refiner, hull', 'a,b'$",
    ):
        rows_in("targets,nome", table)


@pytest.mark.parametrize("override", ["prior=none", "+prior=none", "capture.views=4", "coupling.options.albedo=2"])
def test_what_a_row_sets_itself_is_not_set_for_all(override: str) -> None:
    """Or two rows would be one, under two names."""
    row = "{name: a, overrides: [prior=oracle, coupling=kernel, coupling.options.albedo=1]}"
    Path("t.yaml").write_text(f"scenes: [hat]\ncaptures: [{{}}, {{views: 8}}]\nrows: [{row}]")
    parse(["table=t.yaml", "preset=smoke"]).load()
    with pytest.raises(InputError, match=r"expected a setting that no row has of its own, found it in row 'a"):
        parse(["table=t.yaml", override]).load()


def test_a_scene_of_any_format_is_named_by_its_entry() -> None:
    entry = SceneEntry("cup, 3", "tensoir", "/data/it's", {"lights": "a b", "shrink": 2, "split": ["x", None]}, "phone")
    table = Table(scenes=["tiny", entry])
    assert table.scene_names == ["tiny", "cup, 3"]
    options = ["reader.options.lights='a b'", "reader.options.shrink=2", "reader.options.split=['x', null]"]
    first = ["reader='tensoir'", "scene.name='cup, 3'", r"scene.path='/data/it\'s'", "capture=phone", *options]
    assert [one.overrides for one in table.entries(("cup, 3", "hat"))] == [first, ["scene=hat"]]


def test_a_table_has_the_rows_of_those_that_it_includes() -> None:
    first = "photographs: 24\nscenes: [tiny]\nseeds: [3]\nreference: a\ncurve: [a]\nrows: [{name: a, overrides: []}]\n"
    Path("first.yaml").write_text(first)
    second = "includes: [first.yaml]\nseeds: [4]\nrows: [{name: b, overrides: []}]\nclaims: [{better: b, worse: a}]\n"
    Path("second.yaml").write_text(second)
    table = load_table("second.yaml")
    assert [row.name for row in table.rows] == ["a", "b"]
    assert (table.scenes, table.seeds, table.reference) == (["tiny"], [4], "a")
    assert table.photographs == 24
    for reference, curve in {"a": ["a"], "b": []}.items():
        Path("third.yaml").write_text(f"{second}reference: {reference}\n")
        assert load_table("third.yaml").curve == curve, "more work of a is none of b"
    assert [(claim.better, claim.worse) for claim in table.claims] == [("b", "a")]


def test_every_row_is_run_with_every_capture_unless_it_says_with_which() -> None:
    rows = '[{name: a, overrides: [prior=none]}, {name: b, overrides: [prior=oracle], captures: [""]}]'
    captures = "[{}, {views: 8, radiometry: ldr}, {faults: {mask_growth: -2}}]"
    Path("t.yaml").write_text(f"scenes: [hat]\nreference: a\nrows: {rows}\ncaptures: {captures}\n")
    table = load_table("t.yaml")
    assert [row.name for row in table.crossed_rows] == ["a", "b", "a, 8 views, LDR", "a, mask growth -2.0"]
    assert table.compared is None, "rows of different captures do not compare"
    cells = make_cells(table, TableRequest(overrides=("device=cpu",)), 1, Path("results/t"))
    capture = {cell.row: cell.config.capture for cell in cells}
    assert (capture["a, 8 views, LDR"].views, capture["a, 8 views, LDR"].radiometry) == (8, "ldr")
    assert capture["a, mask growth -2.0"].faults.mask_growth == -2
    assert capture["a"] == capture["b"] == CaptureSettings()


@pytest.mark.parametrize("name", ["1e3", "007", "1.50", "true", "on", "null", "a, b", "é"])
def test_a_text_of_a_capture_reaches_the_run_as_it_is_written(name: str) -> None:
    """Of which a command line without quotes makes another number, true, nothing or a list."""
    captures = f"[{{name: '{name}', sdf: {{align: on}}}}]"
    Path("t.yaml").write_text(f"scenes: [tiny]\nrows: [{{name: a, overrides: []}}]\ncaptures: {captures}")
    (cell,) = make_cells(load_table("t.yaml"), TableRequest(overrides=("device=cpu",)), 1, Path("results/t"))
    assert (cell.config.capture.name, cell.config.capture.sdf.align) == (name, True)


def test_what_a_row_fills_in_is_that_of_each_scene_and_seed(tmp_path: Path) -> None:
    """A cell is what its command line makes, as docs/priors.md and docs/others_results.md have such rows."""
    table = Table(
        scenes=["hat", "tiny"],
        seeds=[0, 1],
        rows=[Row("none", ["prior=none"]), Row("faulty", ["capture.faults.seed=${seed}", "protocol.name=of_${scene.name}"])],
    )
    cells = make_cells(table, TableRequest(overrides=("device=cpu",)), 1, Path("results/t"))
    filled_in = {(cell.scene, cell.seed): (cell.config.protocol.name, cell.config.capture.faults.seed) for cell in cells[4:]}
    assert filled_in == {(scene, seed): (f"of_{scene}", seed) for scene in ("hat", "tiny") for seed in (0, 1)}
    assert [hash_of(identity(compose(cell.config.command))) for cell in cells] == [cell.config_hash for cell in cells]
    for seed in (0, 1):
        (tmp_path / f"seed_{seed}").mkdir()
    scene = SceneEntry("mine", "nerfstudio", f"{tmp_path}/seed_${{seed}}")
    cells = make_cells(replace(table, scenes=[scene]), TableRequest(), 1, Path("results/t"))
    assert {Path(cell.config.scene.path).name for cell in cells if cell.seed == 1} == {"seed_1"}


def test_two_rows_whose_runs_would_lie_in_one_folder_are_refused() -> None:
    """They are one run, since a row's name decides no number; a report would show the second row alone."""
    table = Table(scenes=["tiny"], rows=[Row(name, ["prior=none"]) for name in ("w/o x", "w o x")])
    with pytest.raises(InputError, match="expected the folder of one run, found tiny / w/o x / seed 0 and tiny / w o x / seed 0$"):
        make_cells(table, TableRequest(), 1, Path("results/t"))


def test_tables_may_repeat_what_they_merge() -> None:
    """A key of a table that is merged into another is no key that stands twice."""
    Path("t.yaml").write_text(
        "rows:\n- &one {name: a, overrides: []}\n- {<<: *one, name: b}\n- {<<: *one, name: c}\n- {<<: *one, <<: *one, name: d}\n"
    )
    assert [row.name for row in load_table("t.yaml").rows] == ["a", "b", "c", "d"]
