"""A table is many runs: rows, scenes and seeds from ``conf/table/<name>.yaml``, and the cells that they make."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

from ia_bench.capture.settings import CaptureSettings
from ia_bench.common.errors import InputError
from ia_bench.common.files import read_yaml, user_path
from ia_bench.common.paths import conf_folder
from ia_bench.common.registry import BrokenPlugin
from ia_bench.common.settings import flat, parsed
from ia_bench.common.suggestions import unknown
from ia_bench.runs.composition import compose, written_out
from ia_bench.runs.config import RunConfig, slug
from ia_bench.runs.identity import hash_of, identity
from ia_bench.runs.launchers import Launcher, Local
from ia_bench.scores.columns import METRIC_OF

SET_BY_TABLE = ("scene", "scene.name", "scene.path", "seed", "row", "out")
"""Settings that a table sets for every cell. No command line sets them, nor does a row, whose ``threads`` are the table's too."""


@dataclass
class Claim:
    """Row ``better`` is above row ``worse`` in each of ``metrics``, named as in :attr:`Metric.key`."""

    better: str
    worse: str
    metrics: list[str] = field(default_factory=lambda: ["albedo.psnr", "aligned_albedo.psnr", "relighting.psnr"])


@dataclass
class Row:
    """A row of the table.

    Attributes:
        name: What tables call it.
        overrides: Of the configuration, which make it.
        note: What a reader has to know of it.
        seeds: Its own, None for the table's.
        paper: The row of the paper's table 1 that it stands for, None for one that the paper has not.
        captures: Labels of those of the table's captures that it is run with, None for all of them.
    """

    name: str
    overrides: list[str]
    note: str = ""
    seeds: list[int] | None = None
    paper: str | None = None
    captures: list[str] | None = None


@dataclass
class Table:
    """``conf/table/<name>.yaml``; ``reference`` names the row that the others are compared with, scene by scene.

    ``claims``: orderings of rows that the report judges. ``pictured``: rows that one picture per scene shows beside the truth.
    ``includes``: names of tables whose rows, claims and pictured rows come before its own; what else it does not say is as the
    first of them says. ``captures``: ways to photograph every scene, each of settings of ``capture.*``; none means one that leaves
    nothing out. Every row is run with each (:attr:`crossed_rows`) and compared with the row ``reference`` of the same capture.
    ``photographs``: how many a scene has when none is left out, where no run has recorded it.
    """

    scenes: list[str] = field(default_factory=list)
    seeds: list[int] = field(default_factory=lambda: [0])
    rows: list[Row] = field(default_factory=list)
    reference: str | None = None
    claims: list[Claim] = field(default_factory=list)
    pictured: list[str] = field(default_factory=list)
    includes: list[str] = field(default_factory=list)
    captures: list[dict[str, Any]] = field(default_factory=list)
    photographs: int = 100

    @property
    def crossed_rows(self) -> list[Row]:
        """Every row with every capture, as a row of its own; capture after capture."""
        found = []
        for settings in self.captures or [{}]:
            label = capture_of(settings).label
            overrides = [f"{name}={value}" for name, value in flat(settings, "capture.").items()]
            found += [
                replace(row, name=crossed_name(row.name, label), overrides=[*row.overrides, *overrides], captures=None)
                for row in self.rows
                if row.captures is None or label in row.captures
            ]
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


@dataclass(frozen=True)
class TableRequest:
    """The command line: which table, what replaces its scenes and seeds, how many jobs, overrides for every cell, and where.

    ``table``: a name, or a FILE.yaml. ``rows``: which of its rows, None for all (:func:`some_rows`).
    """

    table: str = "paper"
    scenes: tuple[str, ...] | None = None
    seeds: tuple[int, ...] | None = None
    jobs: int | None = None
    overrides: tuple[str, ...] = ()
    launcher: Launcher = field(default_factory=Local)
    rows: str | None = None

    @property
    def name(self) -> str:
        """What the table is called, and the folder of its results."""
        return title_of(self.table)

    def load(self) -> Table:
        """The table with the rows that are asked for.

        Raises InputError as :func:`load_table`, and for an override of what one of the rows sets itself: it would no longer be
        that row.
        """
        table = load_table(self.table)
        if self.rows is not None:
            table = some_rows(table, self.rows)
        for override in self.overrides:
            key = _key_of(override)
            for row in table.crossed_rows:
                if key in map(_key_of, row.overrides):
                    raise InputError(f"{override}: expected a setting that no row has of its own, found it in row '{row.name}'")
        return table


@dataclass(frozen=True)
class Cell:
    """One run of the table: what it computes, the command line that does, and where its results go."""

    row: Row
    config: RunConfig
    content: dict[str, Any]
    overrides: tuple[str, ...]

    @property
    def config_hash(self) -> str:
        """Identity of the run."""
        return hash_of(self.content)

    @property
    def folder(self) -> Path:
        """The run's folder."""
        assert self.config.out is not None
        return Path(self.config.out)

    @property
    def name(self) -> str:
        """How messages call this cell."""
        return f"{self.config.scene.name} / {self.row.name} / seed {self.config.seed}"

    def log(self, logs: Path) -> Path:
        """The file in the folder ``logs`` for what it says."""
        return logs / f"{slug(self.config.scene.name)}-{self.folder.name}.log"


def title_of(table: str) -> str:
    """What a table is called that is named by a name or a FILE.yaml."""
    return Path(table).stem if table.endswith(".yaml") else table


def load_table(name: str) -> Table:
    """Read the table of that name, or the FILE.yaml, and what it includes.

    Raises InputError naming the closest table, or the file and key at fault.
    """
    path = _file_of(name)
    table = _whole(name, ())
    try:
        labels = [capture_of(settings).label for settings in table.captures]
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    for where, label in ((row.name, label) for row in table.rows for label in row.captures or []):
        if label not in labels:
            raise InputError(f"{path}: rows: {where}: captures: {unknown('capture', label, labels)}")
    for where, override in ((row.name, override) for row in table.rows for override in row.overrides):
        try:
            refuse_own(override, "threads")
        except InputError as error:
            raise InputError(f"{path}: rows: {where}: overrides: {error}") from None
    names = [row.name for row in table.crossed_rows]
    if len(set(names)) != len(names):
        raise InputError(f"{path}: rows: expected different names, found {', '.join(names)}")
    for where, seeds in (("seeds", table.seeds), *((f"rows: {row.name}: seeds", row.seeds) for row in table.rows)):
        if seeds is not None and not seeds:
            raise InputError(f"{path}: {where}: expected at least one, found none")
    if table.reference is not None and table.reference not in (rows := [row.name for row in table.rows]):
        raise InputError(f"{path}: reference: {unknown('row', table.reference, rows)}")
    for row in table.pictured:
        if row not in names:
            raise InputError(f"{path}: pictured: {unknown('row', row, names)}")
    for claim in table.claims:
        for key, found, known in (
            *(("row", row, names) for row in (claim.better, claim.worse)),
            *(("metric", metric, list(METRIC_OF)) for metric in claim.metrics),
        ):
            if found not in known:
                raise InputError(f"{path}: claims: {unknown(key, found, known)}")
    return table


def refuse_own(override: str, *others: str) -> None:
    """Raise InputError for an override of what the table sets for every cell: SET_BY_TABLE and ``others``."""
    key, _, value = override.partition("=")
    if key.lstrip("+~") in (*SET_BY_TABLE, *others):
        raise InputError(f"{key}={value}: the table sets this for every cell; it has scenes=, seeds=, rows= and table=")


def _file_of(name: str) -> Path:
    """``conf/table/NAME.yaml``, or the file that ``name`` ends with .yaml to name. Raises InputError where there is none."""
    if name.endswith(".yaml"):
        return user_path("table", name)
    folder = conf_folder() / "table"
    known = sorted(path.stem for path in folder.glob("*.yaml"))
    if name not in known:
        raise InputError(f"{unknown('table', name, known)} (or the path of a FILE.yaml)")
    return folder / f"{name}.yaml"


def some_rows(table: Table, text: str) -> Table:
    """The ``table`` of those of its rows alone that ``text`` names, with commas between; a name may have commas itself.

    So are its claims, its pictured rows and its reference. Raises InputError for what is no row.
    """
    names, parts, chosen = [row.name for row in table.rows], [part.strip() for part in text.split(",")], list[str]()
    while parts:
        ends = [end for end in range(len(parts), 0, -1) if ", ".join(parts[:end]) in names]
        if not ends:
            raise InputError(f"rows: {unknown('row', parts[0], names)}")
        chosen.append(", ".join(parts[: ends[0]]))
        del parts[: ends[0]]
    return replace(
        table,
        rows=[row for row in table.rows if row.name in chosen],
        reference=table.reference if table.reference in chosen else None,
        claims=[claim for claim in table.claims if claim.better in chosen and claim.worse in chosen],
        pictured=[row for row in table.pictured if row in chosen],
    )


def _whole(name: str, within: tuple[str, ...]) -> Table:
    """A table with what it includes; ``within``: the tables that include it."""
    path = _file_of(name)
    if name in within:
        raise InputError(f"{path}: includes: expected tables that do not include each other, found {' in '.join((name, *within))}")
    own = read_yaml(path)
    try:
        table = parsed(Table, own)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    parts = [_whole(other, (name, *within)) for other in table.includes]
    if not parts:
        return table
    first = ("scenes", "seeds", "reference", "captures", "photographs")
    every: dict[str, Any] = {key: getattr(parts[0], key) for key in first if key not in own}
    for key in ("rows", "claims", "pictured"):
        every[key] = [one for part in (*parts, table) for one in getattr(part, key)]
    return replace(table, **every)


def make_cells(
    table: Table, request: TableRequest, threads: int, results: Path, broken: Callable[[str], None] | None = None
) -> list[Cell]:
    """Every row x capture x scene x seed, composed and checked; row after row, so that jobs side by side differ in scene.

    The request's seeds replace the table's, not those of a row that has its own. A row whose prior or method cannot be used
    has no cell: ``broken`` is told why, once. Raises InputError where there is no cell, or one twice, and for such a row where
    nobody is told.
    """
    seeds, rows = table.seeds if request.seeds is None else request.seeds, table.crossed_rows

    @cache
    def composed(place: int, scene: str) -> RunConfig:
        """A cell of any seed: composing takes long, and nothing of a configuration depends on its seed."""
        row = rows[place]
        overrides = [*row.overrides, *_own(row, scene, 0, threads), *request.overrides]
        return compose(overrides, here=request.launcher.here)

    cells = []
    for place, row in enumerate(rows):
        try:
            cells += [
                _cell(row, replace(composed(place, scene), seed=seed), _own(row, scene, seed, threads), request, results)
                for seed in (seeds if row.seeds is None else row.seeds)
                for scene in (request.scenes if request.scenes is not None else table.scenes)
            ]
        except BrokenPlugin as error:
            if broken is None:
                raise
            broken(f"{row.name}: left out: {error}")
    if not cells:
        raise InputError(f"table {request.name}: expected at least one row and one scene, found none")
    twice = [name for name, count in Counter(cell.name for cell in cells).items() if count > 1]
    if twice:
        raise InputError(f"expected every row, scene and seed once, found {twice[0]} more than once")
    return cells


def _own(row: Row, scene: str, seed: int, threads: int) -> list[str]:
    """The overrides that the table sets for a cell."""
    return [f"scene={scene}", f"seed={seed}", f"threads={threads}", f"row={_quoted(row.name)}"]


def _cell(row: Row, config: RunConfig, own: list[str], request: TableRequest, results: Path) -> Cell:
    content = identity(config)
    folder = results / "runs" / slug(config.scene.name) / f"{slug(row.name)}-seed{config.seed}-{hash_of(content)[:8]}"
    overrides = (*row.overrides, *own, *request.overrides, f"out={_quoted(str(folder))}")
    return Cell(row, replace(config, out=str(folder), command=overrides), content, overrides)


def _key_of(override: str) -> str:
    """Which setting it is of, in Hydra's grammar, its short name written out."""
    return written_out([override])[0].partition("=")[0].lstrip("+~")


def _quoted(text: str) -> str:
    """A text as a value in Hydra's grammar, whatever characters it has."""
    return "'" + text.replace("'", "\\'") + "'"
