"""How the runs of a report were made, and whether they may stand in one table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ia_bench.common.settings import flat
from ia_bench.report.collect import Runs, setup_of

OF_EACH_RUN = ("seed", "scene", "threads", "rescored_from")
"""Parts of an identity in which the runs of one row may differ: which cell it is, its threads, the run behind a new score."""
MOST_KEYS = 5
"""So many settings that differ are named, with their values; of more, how many there are."""
MADE_BY = ("preset", "threads", "commit", "cpu")
UNKNOWN = "unknown"


@dataclass(frozen=True)
class Origin:
    """Runs that were made alike: how many, of which rows, by what; each as it is printed."""

    runs: int
    preset: str
    threads: str
    commit: str
    cpu: str
    rows: str


def origins(runs: Runs) -> list[Origin]:
    """The different ways in which runs were made, the most frequent first."""
    every = runs["row"].nunique()
    made = runs[list(MADE_BY)].astype(object).where(runs[list(MADE_BY)].notna(), UNKNOWN).astype(str)
    found = []
    for (preset, threads, commit, cpu), mine in runs.groupby([made[name] for name in MADE_BY]):
        rows = list(dict.fromkeys(mine["row"]))
        found.append(Origin(len(mine), preset, threads, commit, cpu, "all" if len(rows) == every else "; ".join(rows)))
    return sorted(found, key=lambda one: -one.runs)


def warnings(runs: Runs) -> list[str]:
    """A sentence for everything in which runs differ that should be alike, or that nobody could run again."""
    done = runs[runs["problem"].isna()]
    found = []
    for name, what in (("preset", "presets"), ("threads", "numbers of threads"), ("commit", "commits")):
        counts = done[name].astype(object).where(done[name].notna(), UNKNOWN).value_counts()
        if len(counts) > 1:
            listed = ", ".join(f"{value} ({count})" for value, count in list(counts.items())[:MOST_KEYS])
            more = f" and {len(counts) - MOST_KEYS} more" if len(counts) > MOST_KEYS else ""
            found.append(f"Runs of different {what} stand side by side: {listed}{more}.")
    dirty = int(done["clean"].eq(False).sum())
    if dirty:
        found.append(f"{dirty} of {len(done)} runs were made by changed code, not by that of a commit.")
    return found


def seconds_compare(runs: Runs) -> bool:
    """Whether seconds rank anything: all finished runs are of one machine, with one number of threads."""
    done = runs[runs["problem"].isna()]
    return all(done[name].nunique(dropna=False) <= 1 and done[name].notna().all() for name in ("cpu", "threads"))


def mixed_rows(runs: Runs) -> list[str]:
    """A sentence for every row whose runs differ in more than scene and seed, naming the settings and their values.

    A run whose folder holds no configuration, as of one that only a runs.csv knows, is passed over.
    """
    found = []
    for row, folders in runs.groupby("row", sort=False)["folder"]:
        setups = [setup for folder in folders.unique() if (setup := setup_of(folder)) is not None]
        different = _differing([_deciding(setup.identity) for setup in setups])
        if different:
            words = [f"{key} ({', '.join(values)})" for key, values in list(different.items())[:MOST_KEYS]]
            more = f" and {len(different) - MOST_KEYS} more" if len(different) > MOST_KEYS else ""
            found.append(f"{row}: its runs are not of one configuration, so that its means mix them: {', '.join(words)}{more}")
    return found


def _deciding(identity: Mapping[str, Any]) -> dict[str, Any]:
    return flat({key: value for key, value in identity.items() if key not in OF_EACH_RUN})


def _differing(tables: Sequence[dict[str, Any]]) -> dict[str, list[str]]:
    """Dotted key -> its different values, in the order in which they come; "nothing" where a table lacks it."""
    found = {}
    for key in dict.fromkeys(key for table in tables for key in table):
        values = list(dict.fromkeys(repr(table[key]) if key in table else "nothing" for table in tables))
        if len(values) > 1:
            found[key] = values
    return found
