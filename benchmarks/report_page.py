"""How long the page of a whole table takes, and how large it is: ``python -m benchmarks.report_page RUN... [--rows 19 --seeds 3]``.

RUN are folders of finished runs on shipped scenes. For every scene among them, its runs are laid out in turn under the names of a
table's cells. Runs that have kept no pictures are drawn beforehand, into copies. The report is made three times: into an
empty folder, into the same again, and into another one, which has to have the same bytes. Seconds are those of the processor.
"""

from __future__ import annotations

import argparse
import gzip
import json
import shutil
import tempfile
import time
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from ia_bench.cli.report import main as report
from ia_bench.runs.pictures.drawing import SceneRenderer
from ia_bench.runs.pictures.packing import PICTURES, bundle, read_bundle
from ia_bench.runs.recovered import Recovered


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the seconds, the sizes and whether the bytes are the same."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--rows", type=int, default=19)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--out", type=Path, help="a new folder for a copy of the first report")
    wanted = parser.parse_args(arguments)
    scenes: dict[str, list[Path]] = defaultdict(list)
    for run in wanted.runs:
        scenes[json.loads((run / "metrics.json").read_text(encoding="utf-8"))["scene"]].append(run)
    with tempfile.TemporaryDirectory() as temporary:
        runs, outs = (
            Path(temporary, "runs"),
            [Path(temporary, name) for name in ("one", "two")],
        )  # equally far from the runs
        for scene, found in scenes.items():
            pictures = _pictures(found)
            for row in range(wanted.rows):
                place = row % len(found)
                for seed in range(wanted.seeds):
                    _lay_out(found[place], runs / f"{scene}-{row}-{seed}", f"row {row}", seed, pictures[place])
        print(f"{len(scenes)} scenes x {wanted.rows} rows x {wanted.seeds} seeds, of {len(wanted.runs)} runs")
        for what, out in (("first", outs[0]), ("again", outs[0]), ("elsewhere", outs[1])):
            started = time.process_time()
            if report([str(runs), "--out", str(out)]):
                return 1
            print(f"{what}: {time.process_time() - started:.1f} s")
        if wanted.out:
            shutil.copytree(outs[0], wanted.out)
        pages = [_files(out / "page") for out in outs]
        _print_sizes(pages[0])
        print("the same bytes" if pages[0] == pages[1] else "OTHER BYTES")
    return 0 if pages[0] == pages[1] else 1


def _pictures(runs: Sequence[Path]) -> list[bytes]:
    """What each run on one scene has kept, else drawn."""
    scene_renderer = true = None
    found = []
    for run in runs:
        kept = read_bundle(run)
        if kept is None:
            recovered = Recovered(run)
            if scene_renderer is None:
                scene_renderer = SceneRenderer(recovered.read_scene(whole=True))
                true = scene_renderer.truth(turned=False)
            assert true is not None
            textured = recovered.reconstruction(scene_renderer.stage)
            kept = bundle(scene_renderer, true, textured, scene_renderer.recovered(textured, recovered.scale))
        found.append(kept.zipped())
    return found


def _lay_out(run: Path, folder: Path, row: str, seed: int, pictures: bytes) -> None:
    """The same run under another name: large files as links, its record with the new name."""
    folder.mkdir(parents=True)
    for path in run.iterdir():
        if path.suffix in (".csv", ".json") and path.name != "metrics.json":
            shutil.copyfile(path, folder / path.name)
        elif path.name not in ("metrics.json", PICTURES):
            (folder / path.name).symlink_to(path.resolve())
    (folder / PICTURES).write_bytes(pictures)
    record = json.loads((run / "metrics.json").read_text(encoding="utf-8"))
    (folder / "metrics.json").write_text(json.dumps(record | {"row": row, "seed": seed}), encoding="utf-8")


def _files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _print_sizes(files: dict[str, bytes]) -> None:
    """The whole, the page without its pictures, and what files of one name have in all."""
    sizes: dict[str, int] = defaultdict(int)
    for name, content in files.items():
        sizes[Path(name).name] += len(content)
    print(f"page: {sum(sizes.values()) / 1e6:.2f} MB in {len(files)} files, index.html {sizes['index.html'] / 1e3:.0f} kB", end=" ")
    print(f"({len(gzip.compress(files['index.html'])) / 1e3:.0f} kB compressed)")
    for name, size in sorted(sizes.items(), key=lambda entry: -entry[1])[:16]:
        print(f"  {size / 1e6:6.2f} MB {name}")


if __name__ == "__main__":
    raise SystemExit(main())
