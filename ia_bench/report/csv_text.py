"""Records as the text of a CSV file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import pandas as pd

DIGITS = 7
"""Of what was computed from runs; those themselves are written as they are, so that all else can be computed again."""


def csv_text(records: Iterable[Mapping[str, Any]], digits: int | None = DIGITS) -> str:
    """A line per record below the names of all columns; empty where a record has no value.

    Args:
        records: Column -> value.
        digits: Significant ones of every float; None for all that it has.
    """
    rounded = [
        {key: float(f"{value:.{digits}g}") if digits and isinstance(value, float) else value for key, value in record.items()}
        for record in records
    ]
    return str(pd.DataFrame(rounded, dtype=object).to_csv(index=False))
