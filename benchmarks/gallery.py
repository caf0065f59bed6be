"""The pictures of README and docs/gallery.md: what some rows of a table recover from a scene, beside photograph and truth.

    python -m benchmarks.gallery RUNS [SCENE...] [--rows ROW...] [--parts PART...] [--light sunset] [--out docs/results/pictures]
    python -m benchmarks.gallery RUNS console --rows none combined "diffusion, targets" --parts aligned relit --out docs/images

RUNS is a folder that is searched for runs, of which those with seed 0 are shown. Pictures are those that the runs have kept for
their report's page, and numbers are those of the whole run.
"""

import argparse
import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ia_bench.common.errors import InputError
from ia_bench.runs.folder import find_run_folders
from ia_bench.runs.pictures.drawing import SceneRenderer
from ia_bench.runs.pictures.packing import Bundle, read_bundle
from ia_bench.runs.record import METRICS_FILE, RunRecord
from ia_bench.runs.recovered import Recovered

ROWS = ("none", "combined", "diffusion, kernel", "diffusion, targets", "diffusion, targets w/o specular")
ROWS += ("diffusion, targets w/o albedo", "oracle")
PARTS = {  # sheet of a run -> sheet of the truth, what stands beside the line, and which number below each picture
    "aligned": ("albedo", "aligned\nalbedo", "aligned_albedo.psnr", "{:.1f} dB"),
    "roughness": ("roughness", "roughness,\nblack is 0", "roughness.mse", "MSE {:.4f}"),
    "relit": ("relit", "relit\nunder\n{}", "relighting.psnr", "{:.1f} dB"),
    "light": ("light", "light", "", ""),
}
SIDE, GAP, LINE, BESIDE, FONT = 188, 9, 34, 104, 16  # pixels
QUALITY = 66


def tiles(bundle: Bundle, name: str) -> list[Image.Image]:
    """The pictures of a sheet, one by one."""
    count, columns = bundle.shapes[name]
    sheet = Image.open(io.BytesIO(bundle.sheets[name])).convert("RGB")
    width, height = sheet.width // columns, sheet.height // -(-count // columns)
    places = (divmod(place, columns) for place in range(count))
    return [sheet.crop((column * width, row * height, (column + 1) * width, (row + 1) * height)) for row, column in places]


def found_in(runs: Path, scene: str, rows: list[str]) -> Iterator[tuple[str, Recovered, Bundle]]:
    """Each of the rows with its run on the scene, and its pictures. Raises InputError for a row without."""
    records = ((folder, RunRecord.read(folder)) for folder in find_run_folders(runs) if (folder / METRICS_FILE).is_file())
    folders = {one.row: folder for folder, one in records if (one.scene, one.seed, one.status) == (scene, 0, "ok")}
    for row in rows:
        bundle = read_bundle(folders[row]) if row in folders else None
        if bundle is None:
            raise InputError(f"{runs}: expected a run of row {row} on {scene} with seed 0 and its pictures, found none")
        yield row, Recovered(folders[row]), bundle


def gallery(runs: Path, scene: str, rows: list[str], parts: list[str], light: str) -> Image.Image:
    """The picture of one scene."""
    found = list(found_in(runs, scene, rows))
    drawn = SceneRenderer(found[0][1].read_scene(whole=True))
    true = drawn.truth(turned=False).sheets
    lights = [name for name, views in drawn.relit.items() for _ in views]
    shown = {"photograph": len(true["photograph"]) // 2, "light": 0, "relit": lights.index(light) + lights.count(light) // 2}
    shown |= dict.fromkeys(("aligned", "albedo", "roughness"), shown["photograph"])

    heads = ["photograph", "truth", *(row.replace(" w/o", "\nw/o") for row, _, _ in found)]
    heights = {part: SIDE // 2 if part == "light" else SIDE + LINE for part in parts}
    whole = Image.new("RGB", (BESIDE + len(heads) * (SIDE + GAP), LINE + sum(heights.values())), "white")
    draw, font = ImageDraw.Draw(whole), ImageFont.load_default(FONT)

    def paste(picture: Image.Image, column: int, top: int, below: str = "") -> None:
        left, size = BESIDE + column * (SIDE + GAP), (SIDE, round(SIDE * picture.height / picture.width))
        whole.paste(picture.resize(size, Image.Resampling.BICUBIC), (left, top))
        draw.text((left, top + size[1] + 2), below, "black", font)

    def of_truth(name: str) -> Image.Image:
        return Image.fromarray(np.round(255 * true[name][shown[name]]).astype(np.uint8))

    for column, head in enumerate(heads):
        draw.multiline_text((BESIDE + column * (SIDE + GAP), 0), head, "black", font, spacing=0)
    paste(of_truth("photograph"), 0, LINE)
    top = LINE
    for name, height in heights.items():
        in_truth, beside, metric, text = PARTS[name]
        draw.multiline_text((GAP, top + FONT), beside.format(light), "black", font)
        paste(of_truth(in_truth), 1, top)
        for column, (_, run, bundle) in enumerate(found, 2):
            value = run.record.score(metric)
            paste(tiles(bundle, name)[shown[name]], column, top, "" if value is None else text.format(value))
        top += height
    return whole


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("runs", type=Path)
    parser.add_argument("scenes", nargs="*", default=["hat", "ship", "console", "figurine"])
    parser.add_argument("--rows", nargs="+", default=list(ROWS))
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--light", default="sunset")
    parser.add_argument("--out", type=Path, default=Path("docs/results/pictures"))
    wanted = parser.parse_args()
    wanted.out.mkdir(parents=True, exist_ok=True)
    for scene in wanted.scenes:
        picture = gallery(wanted.runs, scene, wanted.rows, wanted.parts, wanted.light)
        picture.save(wanted.out / f"{scene}.webp", quality=QUALITY, method=6)


if __name__ == "__main__":
    main()
