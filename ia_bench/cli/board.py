"""``ia-bench board PACKS --out FOLDER``: the report over packs of several people, each row named after who brought it."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ia_bench.cli.report import finish
from ia_bench.common.arguments import Parser
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import FAULT, OK, complain, exits
from ia_bench.common.files import read_json
from ia_bench.common.paths import make_writable
from ia_bench.report.collect import CellKey
from ia_bench.report.write import write_report
from ia_bench.runs.packs import check_reader, packs_among, problems, unpack
from ia_bench.runs.record import RunRecord, digest_of
from ia_bench.runs.table import Row, Table

PACKS = "packs"
"""The folder below a board's that holds its packs, unpacked."""
NAMED = 12
"""So many characters of a pack's SHA-256 name its folder there."""


@exits()
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status: 1 if a pack was left out, each of which is named."""
    parser = Parser(prog="ia-bench board", description=__doc__.partition(": ")[2])
    parser.add_argument("packs", nargs="+", type=Path, metavar="PACKS", help="zip files, or folders with some")
    parser.add_argument("--out", type=Path, required=True, help="folder to write into")
    parser.add_argument("--verified", type=Path, metavar="FILE.json", help="written by ia-bench verify --out: rows are marked")
    parser.add_argument("--reference", help="the row, with its authors, that the others are compared with")
    wanted = parser.parse_args(arguments)
    packs = packs_among(wanted.packs)
    verified: Any = None if wanted.verified is None else read_json(wanted.verified).get("packs")
    if wanted.verified is not None and not (isinstance(verified, dict) and all(isinstance(one, dict) for one in verified.values())):
        raise InputError(f"{wanted.verified}: expected what ia-bench verify --out writes, found something else")
    make_writable(wanted.out, "--out")
    for former in (wanted.out / PACKS).glob("[0-9a-f]" * NAMED):  # what a board left there; other things may lie beside it
        shutil.rmtree(former, ignore_errors=True)
    cells: dict[Path, CellKey | None] = {}
    notes: dict[str, dict[str, None]] = {}  # of a row, what each of its packs says, once
    labels: dict[str, str] = {}  # "row (authors)" -> that with its mark
    taken = set[tuple[str, str, str, int]]()  # authors, row, scene and seed of what is shown
    left_out = 0
    for path in packs:
        if (digest := digest_of(path)) is None:
            complain(f"{path}: expected a pack, found none that can be read; the pack is left out")
            left_out += 1
            continue
        place = wanted.out / PACKS / digest[:NAMED]
        try:
            manifest = unpack(path, place)
            for run in manifest.runs:
                check_reader(place / run.folder)
                if said := problems(run, place):
                    raise InputError(f"{path}: {run.folder}: {'; '.join(said)}")
            records = {run.folder: RunRecord.read(place / run.folder) for run in manifest.runs}
            brought = [(manifest.authors, record.row, record.scene, record.seed) for record in records.values()]
            for (authors, *cell), count in Counter(brought).items():
                if count > 1 or (authors, *cell) in taken:
                    raise InputError(f"{path}: expected one run of {', '.join(map(str, cell))} by {authors}, found another")
            taken |= {*brought}
        except InputError as error:  # of this pack; the others are shown
            complain(f"{error}; the pack is left out")
            shutil.rmtree(place, ignore_errors=True)
            left_out += 1
            continue
        states = None if verified is None else verified.get(digest, {})
        for row in dict.fromkeys(record.row for record in records.values()):
            runs = {folder: record for folder, record in records.items() if record.row == row}
            mark, said = "", ["brought by " + " ".join(filter(None, (manifest.authors, manifest.url)))]
            if states is not None:
                count = sum(states.get(folder) == "verified" for folder in runs)
                mark = ", verified" if count == len(runs) else ", not verified"
                said.append(f"{count} of {len(runs)} runs scored again with the same result")
            declared = [record.declared for record in runs.values() if record.declared is not None]
            told = "seconds as they declare them" if any(one.seconds is not None for one in declared) else "no seconds declared"
            said.append(told if declared else "seconds as measured by the runs")
            label = f"{row} ({manifest.authors}{mark})"
            labels.setdefault(f"{row} ({manifest.authors})", label)  # the first that is brought, where two are called so
            notes.setdefault(label, {})["; ".join([*said, *filter(None, [manifest.note])])] = None
            cells |= {place / folder: (label, record.scene, record.seed) for folder, record in runs.items()}
    if not cells:
        raise InputError(f"{', '.join(map(str, wanted.packs))}: expected a pack that can be shown, found none")
    rows = [Row(label, [], "; ".join(note)) for label, note in notes.items()]
    finish(
        write_report(cells, wanted.out, Table(rows=rows, reference=labels.get(wanted.reference, wanted.reference))),
        wanted.out,
        "board",
    )
    return FAULT if left_out else OK
