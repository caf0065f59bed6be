"""A table is many runs: rows, scenes and seeds from ``conf/table/<name>.yaml``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from ia_bench.capture.settings import CaptureSettings
from ia_bench.common.errors import InputError, unknown
from ia_bench.common.files import read_yaml, user_path
from ia_bench.common.paths import conf_folder
from ia_bench.common.ranges import Name
from ia_bench.common.settings import flat, parsed, parsed_file
from ia_bench.runs.composition import setting, written
from ia_bench.scores.metrics import METRIC_OF

SET_BY_TABLE = ("scene", "scene.name", "scene.path", "reader", "seed", "row", "out")
"""Settings that a table sets for every cell. No command line sets them, nor does a row, which sets no others of a reader either."""

Some = Field(min_length=1)
Seeds = Annotated[list[Annotated[int, Field(ge=0, lt=2**63)]], Some]
Cost = Annotated[float, Field(gt=0)]


@dataclass(frozen=True)
class SceneEntry:
    """A scene of a table, of any format; one that is given by its name alone is a shipped one.

    Attributes:
        name: What the table calls it.
        reader: The name of its reader, or "module:Class".
        path: What the reader is given; None for the shipped scene of that name, and for readers that need no folder.
        options: The options of the reader.
        capture: A capture of conf/capture for this scene, where the table has none for all; None for as it is read.
    """

    name: Name
    reader: str = "native"
    path: str | None = None
    options: dict[str, Any] = field(default_factory=dict)
    capture: str | None = None

    @property
    def overrides(self) -> list[str]:
        """The command-line settings by which a run reads this scene."""
        if self == SceneEntry(self.name):
            return [f"scene={self.name}"]
        found = [f"reader={written(self.reader)}", f"scene.name={written(self.name)}"]
        found += [] if self.path is None else [f"scene.path={written(self.path)}"]
        found += [] if self.capture is None else [f"capture={self.capture}"]
        return [*found, *(f"reader.options.{key}={written(value)}" for key, value in self.options.items())]


@dataclass
class Claim:
    """Row ``better`` is above row ``worse`` in each of ``metrics``, named as in :attr:`Metric.key`."""

    better: str
    worse: str
    metrics: Annotated[list[str], Some] = field(default_factory=lambda: ["albedo.psnr", "aligned_albedo.psnr", "relighting.psnr"])


@dataclass
class Row:
    """A row of the table.

    Attributes:
        name: What tables call it.
        overrides: The command-line settings that turn the default run into this row.
        note: What a reader has to know of it.
        paper: The row of the paper's table 1 that it stands for, None for one that the paper has not.
        captures: Labels of those of the table's captures that it is run with, None for all of them.
        cost: CPU seconds of a fit, in any unit that all rows share, measured with threads=1 on a core of their own; or those of
            each capture, by its label. A report takes them where runs have not recorded their own.
    """

    name: Name
    overrides: list[str]
    note: str = ""
    paper: str | None = None
    captures: Annotated[list[str], Some] | None = None
    cost: Cost | dict[str, Cost] | None = None


@dataclass
class Table:
    """``conf/table/<name>.yaml``.

    Attributes:
        scenes: Names, or a :class:`SceneEntry` each.
        reference: The row that the others are compared with, scene by scene.
        claims: Orderings of rows that the report judges.
        curve: Rows that are the reference with more work; what they reach is what the reference has after more seconds.
        includes: Tables whose rows and claims come before its own; what else it does not say is as the first of them says.
        captures: Ways to photograph every scene, each of settings of ``capture.*``; none means one that leaves nothing out. Every
            row is run with each (:attr:`crossed_rows`) and compared with the row ``reference`` of the same capture.
        photographs: How many a scene has when none is left out, where no run has recorded it.
    """

    scenes: list[Name | SceneEntry] = field(default_factory=list)
    seeds: Seeds = field(default_factory=lambda: [0])
    rows: list[Row] = field(default_factory=list)
    reference: str | None = None
    claims: list[Claim] = field(default_factory=list)
    curve: list[str] = field(default_factory=list)
    includes: list[str] = field(default_factory=list)
    captures: Annotated[list[dict[str, Any]], Some] = field(default_factory=list)
    photographs: Annotated[int, Field(ge=1)] = 100

    @property
    def scene_names(self) -> list[str]:
        """What the table calls its scenes."""
        return [scene if isinstance(scene, str) else scene.name for scene in self.scenes]

    def entries(self, names: Sequence[str] | None) -> list[SceneEntry]:
        """Its scenes, or those that are called ``names``, of which those that it does not list are shipped ones."""
        own = {scene.name: scene for scene in self.scenes if isinstance(scene, SceneEntry)}
        return [own.get(name, SceneEntry(name)) for name in (self.scene_names if names is None else names)]

    @property
    def crossed_rows(self) -> list[Row]:
        """Every row with every capture, as a row of its own; capture after capture."""
        found = []
        for settings in self.captures or [{}]:
            label, more = capture_of(settings).label, [setting(name, value) for name, value in flat(settings, "capture.").items()]
            for row in self.rows:
                if row.captures is None or label in row.captures:
                    name, overrides = crossed_name(row.name, label), [*row.overrides, *more]
                    cost = row.cost.get(label) if isinstance(row.cost, dict) else row.cost
                    found.append(replace(row, name=name, overrides=overrides, captures=None, cost=cost))
        return found

    @property
    def compared(self) -> str | None:
        """The row that all others are compared with; None where each is compared with the reference of its own capture."""
        return None if self.captures else self.reference

    @property
    def papers(self) -> dict[str, str]:
        """Row -> the row of the paper's table that it stands for, of those that have one."""
        return {row.name: row.paper for row in self.rows if row.paper is not None}


def capture_of(settings: Mapping[str, Any]) -> CaptureSettings:
    """One of :attr:`Table.captures`. Raises InputError for what is no setting of a capture."""
    return parsed(CaptureSettings, settings, "captures")


def crossed_name(row: str, capture: str) -> str:
    """What the row of a table is called when it is run with the capture of this label."""
    return f"{row}, {capture}" if capture else row


def title_of(table: str) -> str:
    """What a table is called that is named by a name or a FILE.yaml."""
    return Path(table).stem if table.endswith(".yaml") else table


def load_table(name: str) -> Table:
    """Read the table of that name, or the FILE.yaml, and what it includes.

    Raises InputError naming the closest table, or the file and key at fault.
    """
    table = _whole(name, ())
    try:
        _check(table)
    except InputError as error:
        raise InputError(f"{_file_of(name)}: {error}") from None
    return table


def _check(table: Table) -> None:
    """Raise InputError for the first name that stands for nothing, or twice."""
    labels = [capture_of(settings).label for settings in table.captures]
    names, rows = [row.name for row in table.crossed_rows], [row.name for row in table.rows]
    wanted = [(f"rows: {row.name}: captures", "capture", label, labels) for row in table.rows for label in row.captures or []]
    costs = {row.name: row.cost for row in table.rows if isinstance(row.cost, dict)}
    wanted += [(f"rows: {name}: cost", "capture", label, labels) for name, cost in costs.items() for label in cost]
    wanted += [("reference", "row", table.reference, rows)] if table.reference is not None else []
    wanted += [("curve", "row", name, rows) for name in table.curve]
    for claim in table.claims:
        wanted += [("claims", "row", name, names) for name in (claim.better, claim.worse)]
        wanted += [("claims", "metric", metric, list(METRIC_OF)) for metric in claim.metrics]
    for where, what, found, known in wanted:
        if found not in known:
            raise InputError(f"{where}: {unknown(what, found, known)}")
    if table.curve and table.reference is None:
        raise InputError(
            f"curve: expected a reference beside it, which these rows are with more work, found none: {table.curve[0]}"
        )
    claimed = Counter((frozenset((one.better, one.worse)), metric) for one in table.claims for metric in one.metrics)
    for (two, metric), count in claimed.items():  # twice would be two of a family, of which then fewer are decided
        if count > 1 or len(two) < 2:
            found = f"{' and '.join(sorted(two))} {f'{count} times' if count > 1 else 'alone'}"
            raise InputError(f"claims: expected two rows, and these once in {metric}, found {found}")
    photographed = {name for settings in table.captures for name in flat(settings, "capture.")}
    for row in table.rows:
        for override in row.overrides:
            refuse_own(override, "threads", "reader.", "hydra", where=f"rows: {row.name}: overrides: ")
            if key_of(override) in photographed:  # which would take its place, or be called by a label without it
                raise InputError(f"rows: {row.name}: overrides: {override}: expected none of the table's captures, which set this")
    for what, several in (("rows", names), ("scenes", table.scene_names)):
        if len(set(several)) != len(several):
            raise InputError(f"{what}: expected different names, found {', '.join(several)}")
        if filled_in := [name for name in several if "${" in name]:  # overrides alone are: cells are listed by these names
            raise InputError(f"{what}: expected names without ${{, which a cell would fill in, found {filled_in[0]}")
    for entry in table.entries(None):
        if entry.capture is not None and table.captures:
            raise InputError(f"scenes: {entry.name}: capture: expected none in a table that has captures, found {entry.capture}")


def key_of(override: str) -> str:
    """The setting that an override sets: ``seed`` of ``+seed=3``."""
    return override.partition("=")[0].lstrip("+~")


def refuse_own(override: str, *others: str, where: str = "") -> None:
    """Raise InputError for an override of what the table sets for every cell: SET_BY_TABLE, and what begins with ``others``."""
    if key_of(override) in SET_BY_TABLE or key_of(override).startswith(others):
        raise InputError(f"{where}{override}: the table sets this for every cell; it has scenes=, seeds=, rows= and table=")


def _file_of(name: str) -> Path:
    """``conf/table/NAME.yaml``, or the file that ``name`` ends with .yaml to name. Raises InputError where there is none."""
    if name.endswith(".yaml"):
        return user_path("table", name)
    folder = conf_folder() / "table"
    known = sorted(path.stem for path in folder.glob("*.yaml"))
    if name not in known:
        raise InputError(f"{unknown('table', name, known)} (or the path of a FILE.yaml)")
    return folder / f"{name}.yaml"


def rows_in(text: str, table: Table) -> list[str]:
    """The rows of the ``table`` that ``text`` names, with commas between, as names may have. Raises InputError for what is none."""
    known = {", ".join(_parts(row.name)): row.name for row in table.rows}
    rest, chosen = _parts(text), list[str]()
    while rest:
        end = next((end for end in range(len(rest), 0, -1) if ", ".join(rest[:end]) in known), 0)
        if not end:
            raise InputError(f"rows: {unknown('row', rest[0], known.values())}")
        chosen.append(known[", ".join(rest[:end])])
        rest = rest[end:]
    if len(set(chosen)) != len(chosen):
        raise InputError(f"rows: expected every row once, found {', '.join(chosen)}")
    return chosen


def _parts(text: str) -> list[str]:
    return [part.strip() for part in text.split(",")]


def some_rows(table: Table, chosen: Sequence[str]) -> Table:
    """The ``table`` of those of its rows, claims and reference alone that are ``chosen``."""
    reference = table.reference if table.reference in chosen else None
    curve = [name for name in table.curve if name in chosen]
    some = replace(table, rows=[row for row in table.rows if row.name in chosen], reference=reference, claims=[], curve=curve)
    crossed = {row.name for row in some.crossed_rows}  # as claims call them
    return replace(some, claims=[claim for claim in table.claims if {claim.better, claim.worse} <= crossed])


def _whole(name: str, within: tuple[str, ...]) -> Table:
    """A table with what it includes; ``within``: the tables that include it."""
    path = _file_of(name)
    if name in within:
        raise InputError(f"{path}: includes: expected tables that do not include each other, found {' in '.join((name, *within))}")
    own = read_yaml(path)
    table = parsed_file(Table, path, own)
    parts = [_whole(other, (name, *within)) for other in table.includes]
    if not parts:
        return table
    every = {
        key: getattr(parts[0], key)
        for key in ("scenes", "seeds", "reference", "curve", "captures", "photographs")
        if key not in own
    }
    if "curve" not in own and every.get("reference", table.reference) != parts[0].reference:
        every["curve"] = []  # those are more work of another row
    every |= {key: [one for part in (*parts, table) for one in getattr(part, key)] for key in ("rows", "claims")}
    return replace(table, **every)
