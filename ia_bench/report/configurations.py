"""Whether the runs of a row share one configuration, as they should where one mean and one interval are made of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json
from ia_bench.common.settings import flat
from ia_bench.report.collect import Run
from ia_bench.runs.folder import CONFIG

OF_EACH_RUN = ("seed", "scene", "threads", "rescored_from")
"""Parts of a configuration in which the runs of one row may differ: which cell it is, its threads, the run behind a new score."""
MOST_KEYS = 5
"""So many settings that differ are named, with their values; of more, how many there are."""


def mixed_rows(runs: Sequence[Run]) -> list[str]:
    """A sentence for every row whose runs differ in more than scene and seed, naming the settings and their values.

    A run whose folder holds no configuration, as of one that only a runs.csv knows, is passed over.
    """
    rows: dict[str, list[dict[str, Any]]] = {}
    for run in runs:
        settings = _settings(run)
        if settings:
            rows.setdefault(run.row, []).append(settings)
    found = []
    for row, tables in rows.items():
        differing = _differing(tables)
        if differing:
            words = [f"{key} ({', '.join(values)})" for key, values in list(differing.items())[:MOST_KEYS]]
            more = f" and {len(differing) - MOST_KEYS} more" if len(differing) > MOST_KEYS else ""
            found.append(f"{row}: its runs are not of one configuration, so that its means mix them: {', '.join(words)}{more}")
    return found


def _settings(run: Run) -> dict[str, Any]:
    try:
        config = read_json(run.folder / CONFIG).get("config")
    except InputError:
        return {}
    return flat({key: value for key, value in config.items() if key not in OF_EACH_RUN}) if isinstance(config, dict) else {}


def _differing(tables: Sequence[dict[str, Any]]) -> dict[str, list[str]]:
    """Dotted key -> its different values, in the order in which they come; "nothing" where a table lacks it."""
    found = {}
    for key in dict.fromkeys(key for table in tables for key in table):
        values = list(dict.fromkeys(repr(table[key]) if key in table else "nothing" for table in tables))
        if len(values) > 1:
            found[key] = values
    return found
