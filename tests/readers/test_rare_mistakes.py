"""Rarer mistakes in others' data than those of test_mistakes.py: photographs that come twice, and texts and types that are odd."""

import shutil
from pathlib import Path

import pytest
from layouts import LAYOUTS, Layout
from spoils import edited, gone, wrote
from test_mistakes import OWN, SFM, SPARSE, TRAIN, WHOLE, Mistakes, expect_told

from ia_bench.readers.writers.parts import Options

MISTAKES: dict[str, Mistakes] = {
    "nerfstudio": {
        "a name of 300 letters": (
            edited(WHOLE, lambda c: [c.pop("train_filenames"), c["frames"][3].update(file_path=300 * "a")]),
            r"frames\[3\]: file_path: a+: no such file",
        ),
    },
    "colmap": {
        "a line a photograph": (
            wrote(f"{SPARSE}/images.txt", "".join(f"{n} 1 0 0 0 0 0 3 1 my photo {n:04}.png\n" for n in range(1, 20))),
            r"images\.txt: expected images of a sparse model of COLMAP",
        ),
    },
    "neilf": {
        "no paths": (
            edited(SFM, lambda c: c["image_path"].update(file_paths=None)),
            "file_paths: expected an object, found NoneType",
        ),
    },
    "llff": {
        "two formats of one name": (
            lambda at: [gone("images/018.png")(at), shutil.copy(at / "images/017.png", at / "images/017.webp")],
            r"masks/017\.png: expected the mask of one photograph, found it for 2 of one name",
        ),
    },
    "stanford_orb": {
        "test is training": (
            lambda at: shutil.copy(at / OWN / TRAIN, at / OWN / "transforms_test.json"),
            r"transforms_test\.json: frames\[0\]: file_path: expected every photograph once",
        ),
    },
}
CASES = [(one, mistake) for one in LAYOUTS for mistake in MISTAKES.get(one.id, {})]


@pytest.mark.parametrize(("layout", "mistake"), CASES, ids=[f"{one.id}-{mistake}" for one, mistake in CASES])
def test_a_rare_mistake_is_told(layout: Layout, mistake: str, written: dict[str, tuple[Path, Options]], tmp_path: Path) -> None:
    expect_told(*MISTAKES[layout.id][mistake], layout, written, tmp_path)
