"""``make real-data``: the real data that sources.toml lists, into results/real, from a folder that has it or from its repositories.

From a folder every file is copied, once its SHA-256 is the listed one. From the repositories, by git at the listed commits, only
that comes whose change can be made again: lights, and captures whose poses are the source's. A light is then the pack's to the
byte; a photograph is encoded by another JPEG library perhaps, so its sum may differ. Every source that fails is one sentence.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageOps

from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import FAULT, OK, status_of
from ia_bench.readers.pictures import recorded_exposure
from ia_bench.scenes.color import linear_to_srgb, srgb_to_linear
from ia_bench.scenes.exr import read_rgbe, rgbe_texels

HERE = Path(__file__).resolve().parent
LONG_SIDE, QUALITY = 640, 93  # of a photograph in the pack
HASHED = 40  # digits of a whole commit, which servers give without the history before it
SHORTEST, LONGEST_RUN, LONGEST_LITERAL = 4, 127, 128  # texels of a run in an RGBE picture


# ---------------------------------------------------------------- lists
def listed(folder: Path, non_commercial: bool) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """The sources of ``folder``, and the SHA-256 (hex) of every file by its path in the pack."""
    sources, sums = list[dict[str, Any]](), dict[str, str]()
    for suffix in ("", "_nc") if non_commercial else ("",):
        sources += tomllib.loads((folder / f"sources{suffix}.toml").read_text("utf-8"))["source"]
        lines = (folder / f"sums{suffix}.sha256").read_text("utf-8").splitlines()
        sums |= {path: digest for digest, path in (line.split("  ", 1) for line in lines)}
    return sources, sums


def files_of(source: dict[str, Any], sums: Iterable[str]) -> list[str]:
    """The files of the pack that are made of ``source``."""
    named = [*source.get("files", []), *source.get("paths", {})]
    return [path for path in sums if any(path == name or (name.endswith("/") and path.startswith(name)) for name in named)]


def same(path: Path, digest: str) -> bool:
    """Whether the file is there and has this SHA-256."""
    return path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == digest


# ---------------------------------------------------------------- from a folder
def copied(folder: Path, out: Path, sums: dict[str, str]) -> None:
    """Copy every file from ``folder``. Raises InputError, before anything is written, where one is missing or another one."""
    if not folder.is_dir():
        raise InputError(f"FROM={folder}: expected a folder with the real data, found none")
    wrong = [path for path, digest in sums.items() if not same(folder / path, digest)]
    if wrong:
        what = "another file" if (folder / wrong[0]).is_file() else "none"
        raise InputError(f"FROM={folder}: expected {wrong[0]} as it is listed, found {what} ({len(wrong)} of {len(sums)} files)")
    for path in sums:
        place = out / path
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(folder / path, place)


# ---------------------------------------------------------------- from the repositories
def git(folder: Path, *arguments: str) -> None:
    """Run git in ``folder``. Raises InputError with git's own last line where it fails."""
    done = subprocess.run(
        ["git", "-C", str(folder), *arguments], capture_output=True, text=True, env={**os.environ, "GIT_TERMINAL_PROMPT": "0"}
    )
    if done.returncode:
        raise InputError(f"git {arguments[0]}: {(done.stderr.strip().splitlines() or ['no reason given'])[-1]}")


def checked_out(source: dict[str, Any], folder: Path, paths: Sequence[str]) -> None:
    """Check out ``paths`` of the source at its commit in ``folder``: one commit alone where its whole name is known."""
    commit = source["commit"]
    git(folder, "init", "--quiet")
    git(folder, "remote", "add", "origin", f"https://github.com/{source['repository']}")
    git(folder, "sparse-checkout", "set", "--no-cone", *(f"/{path}" for path in paths))
    alone = ["--depth", "1", "origin", commit] if len(commit) == HASHED else ["origin"]
    git(folder, "fetch", "--quiet", "--filter=blob:none", *alone)
    git(folder, "checkout", "--quiet", commit)


def fetched(source: dict[str, Any], out: Path, sums: dict[str, str]) -> None:
    """Make the files of one source below ``out``. Raises InputError where it cannot be had, or is not what was expected."""
    wanted = source["paths"].values() if "paths" in source else ("images/", "masks/", "poses_bounds.npy")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        checked_out(source, folder, list(wanted))
        RECIPES[source["recipe"]](source, folder, out, sums)


# ---- lights: the mean of every 2 x 2 texels ----


def lights(source: dict[str, Any], folder: Path, out: Path, sums: dict[str, str]) -> None:
    """Maps of half the size, each texel the nearest RGBE value to the mean of four."""
    for place, path in source["paths"].items():
        whole = read_rgbe(folder / path).astype(np.float64)
        height, width = whole.shape[0] // 2, whole.shape[1] // 2
        mean = whole[: 2 * height, : 2 * width].reshape(height, 2, width, 2, 3).mean((1, 3))
        title = f"{Path(place).stem}, Poly Haven, CC0; 2x2 mean of the 1k map"
        (out / place).parent.mkdir(parents=True, exist_ok=True)
        (out / place).write_bytes(rgbe(mean, title))


def rgbe(image: np.ndarray, title: str) -> bytes:
    """A run-length encoded Radiance picture of (H, W, 3) linear values >= 0."""
    texels = rgbe_texels(image)
    height, width = image.shape[:2]
    rows = (b"\x02\x02" + width.to_bytes(2, "big") + b"".join(run_lengths(row[:, k].tobytes()) for k in range(4)) for row in texels)
    return f"#?RADIANCE\n# {title}\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode() + b"".join(rows)


def run_lengths(row: bytes) -> bytes:
    """One channel of a row as runs (128 + length, value) and literals (length, values)."""

    def run(start: int) -> int:
        end = start + 1
        while end < len(row) and end - start < LONGEST_RUN and row[end] == row[start]:
            end += 1
        return end - start

    coded, place = bytearray(), 0
    while place < len(row):
        end = place + run(place)
        if end - place >= SHORTEST:
            coded += bytes([128 + end - place, row[place]])
        else:
            end = place + 1
            while end < len(row) and end - place < LONGEST_LITERAL and run(end) < SHORTEST:
                end += 1
            coded += bytes([end - place]) + row[place:end]
        place = end
    return bytes(coded)


# ---- captures with poses of their own, in LLFF's layout ----


def capture(source: dict[str, Any], folder: Path, out: Path, sums: dict[str, str]) -> None:
    """Smaller photographs and masks, LLFF's poses for them, and transforms.json with OpenGL's camera-to-world matrices.

    A pose (3, 5) of LLFF has the columns down, right, back, position, and (height, width, focal length in pixels).
    """
    (prefix,) = source["files"]
    photographs = sorted(path for path in (folder / "images").glob("*") if path.suffix.lower() in (".jpg", ".jpeg"))
    stored = np.load(folder / "poses_bounds.npy", allow_pickle=False)
    if len(stored) != len(photographs):
        raise InputError(f"poses_bounds.npy: expected a pose for each of {len(photographs)} photographs, found {len(stored)}")
    poses = stored[:, :15].reshape(-1, 3, 5).copy()
    matrices = np.tile(np.eye(4), (len(poses), 1, 1))
    matrices[:, :3] = np.stack([poses[..., 1], -poses[..., 0], poses[..., 2], poses[..., 3]], -1)
    target, frames, exposures = out / prefix, list[dict[str, Any]](), list[float | None]()
    for name in ("images", "masks"):
        (target / name).mkdir(parents=True, exist_ok=True)
    for number, photo in enumerate(photographs):
        image = f"images/{photo.stem}.jpg"
        if f"{prefix}{image}" not in sums:
            raise InputError(f"{photo.name}: expected a photograph that sums.sha256 lists, found another one")
        mask = next(iter([*(folder / "masks").glob(f"{photo.stem}_mask.*"), *(folder / "masks").glob(f"{photo.stem}.*")]), None)
        if mask is None:
            raise InputError(f"{photo.name}: expected a mask, found none")
        width, height = smaller_photograph(photo, target / image)
        smaller_mask(mask, target / "masks" / f"{photo.stem}.png", (width, height))
        exposures.append(recorded_exposure(photo))
        factor = width / poses[number, 1, 4]
        poses[number, :, 4] = height, width, factor * poses[number, 2, 4]
        names = {"file_path": image, "mask_path": f"masks/{photo.stem}.png"}
        frames.append({**names, "transform_matrix": matrices[number].tolist()})
    known = [value for value in exposures if value is not None]
    for frame, value in zip(frames, exposures, strict=True):
        if value is not None and len(known) == len(frames):
            frame["exposure"] = value / float(np.median(known))
    height, width, focal = map(float, poses[0, :, 4])
    camera = {"w": int(width), "h": int(height), "fl_x": focal, "fl_y": focal, "cx": width / 2, "cy": height / 2}
    stored[:, :15] = poses.reshape(-1, 15)
    np.save(target / "poses_bounds.npy", stored)
    lens = dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0)
    content = {"camera_model": "OPENCV", **camera, **lens, "frames": frames}
    (target / "transforms.json").write_text(json.dumps(content, indent=1) + "\n", "utf-8")


def smaller_photograph(path: Path, place: Path) -> tuple[int, int]:
    """Write the photograph with LONG_SIDE pixels, averaged in linear light; its width and height."""
    with Image.open(path) as picture:
        linear = srgb_to_linear(np.asarray(picture.convert("RGB"), np.float32) / 255)
    height, width = linear.shape[:2]
    size = (round(LONG_SIDE * width / max(width, height)), round(LONG_SIDE * height / max(width, height)))
    channels = [np.asarray(Image.fromarray(linear[..., k].astype(np.float32)).resize(size, Image.Resampling.BOX)) for k in range(3)]
    codes = np.rint(255 * linear_to_srgb(np.stack(channels, -1).clip(0, 1))).astype(np.uint8)
    Image.fromarray(codes).save(place, "JPEG", quality=QUALITY, subsampling=0)
    return size


def smaller_mask(path: Path, place: Path, size: tuple[int, int]) -> None:
    """Write the mask, binarised at 127, as a PNG of ``size``: grey at the rim is coverage."""
    with Image.open(path) as picture:
        mask = ImageOps.grayscale(picture.convert("RGB")).point(lambda value: 255 * (value > 127))
    mask.resize(size, Image.Resampling.BOX).save(place)


RECIPES: dict[str, Callable[[dict[str, Any], Path, Path, dict[str, str]], None]] = {"mean_of_2x2": lights, "llff": capture}


# ---------------------------------------------------------------- the command
def main(arguments: Sequence[str]) -> int:
    """Put the real data into ``--out``. Exit code 0 where all was had that can be, 1 where a source failed, 2 for a mistake."""
    parser = argparse.ArgumentParser(prog="make real-data", description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--from", dest="folder", type=Path, help="a folder that has the data; without it, git fetches what it can")
    parser.add_argument("--nc", action="store_true", help="the non-commercial data, too (CC BY-NC-SA, CC BY-NC)")
    parser.add_argument("--out", type=Path, default=Path("results/real"))
    parser.add_argument("--lists", type=Path, default=HERE, help=argparse.SUPPRESS)
    chosen = parser.parse_args(arguments)
    return status_of(lambda: _made(chosen))


def _made(chosen: argparse.Namespace) -> int:
    sources, sums = listed(chosen.lists, chosen.nc)
    failed = 0
    if chosen.folder is not None:
        copied(chosen.folder, chosen.out, sums)
    else:
        failed = _from_repositories(sources, chosen.out, sums)
    there = [path for path in sums if (chosen.out / path).is_file()]
    equal = sum(same(chosen.out / path, sums[path]) for path in there)
    print(f"{chosen.out}: {len(there)} of {len(sums)} files, {equal} of them as they are listed, to the byte")
    return FAULT if failed else OK


def _from_repositories(sources: Sequence[dict[str, Any]], out: Path, sums: dict[str, str]) -> int:
    """Fetch what is not there yet; how many sources failed."""
    failed, without = 0, dict[str, int]()
    for source in sources:
        wanted = files_of(source, sums)
        if all((out / path).is_file() for path in wanted):
            continue
        if "recipe" not in source:
            without[source["repository"]] = without.get(source["repository"], 0) + len(wanted)
            continue
        try:
            fetched(source, out, sums)
            print(f"{source['repository']}: {len(wanted)} files")
        except (InputError, OSError, ValueError) as error:
            failed += 1
            print(f"{source['repository']} at {source['commit'][:10]}: left out: {error}", file=sys.stderr)
    if without:
        names = ", ".join(without)
        print(f"{sum(without.values())} files are only to be had by FROM=FOLDER, as how they were changed is no recipe: of {names}")
    return failed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
