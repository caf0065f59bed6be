"""Times to a level, of made-up curves whose answers are worked out by hand."""

from __future__ import annotations

from benchmarks.former_commit import NOW, Curve, table


def curve(*points: tuple[float, float]) -> Curve:
    return [{"seconds": str(seconds), "relighting_psnr": str(value)} for seconds, value in points]


FAST = [curve((1, 20), (2, 23.5), (4, 25)), curve((1, 20), (3, 23.1), (5, 25.2))]
SLOW = [curve((2, 20), (8, 22.5), (16, 24)), curve((2, 20), (10, 22.9), (20, 23.9))]


def test_the_table_has_levels_that_this_code_reaches() -> None:
    lines = table({NOW: FAST, "former": SLOW}, "relighting_psnr")
    assert lines[0] == "| relighting, dB | this code, s | former, s | times sooner |"
    assert lines[2:] == [
        "| 21 | 2.5 (2.0 to 3.0) | 9.0 (8.0 to 10.0) | 3.6 |",
        "| 22 | 2.5 (2.0 to 3.0) | 9.0 (8.0 to 10.0) | 3.6 |",
        "| 23 | 2.5 (2.0 to 3.0) | 18.0 (16.0 to 20.0) | 7.2 |",
        "| 24 | 4.5 (4.0 to 5.0) | never (16.0 to never) | never |",
        "| 25 | 4.5 (4.0 to 5.0) | never | never |",
    ]
