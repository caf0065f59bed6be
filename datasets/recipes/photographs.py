"""Photographed lights: the HDR maps of the npm package `@pmndrs/assets`, fetched, read, clamped and resampled.

    python datasets/recipes/photographs.py        # energy that clamping adds to every map, and how bright its peak is

The package is in the public domain (CC0). `package/hdri/NAME.exr.js` holds a map of 256 x 512 texels as an EXR file in
base64, made for three.js: +y is up, and the middle column looks along +x. Turned so that +z is up, (x, y, z) -> (x, -z, y),
that is the convention of `latlong.py`, row by row and column by column, so nothing is flipped or rolled.

The maps were made smaller by a filter that rings: beside a sun they fall below zero, where radiance cannot be. `clamp` makes
such values 0. That adds energy, since the overshoot that they were to balance stays. The maps DAMAGED lost the red and the
green of their suns, which have been blue since.
"""

import base64
import hashlib
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

import numpy as np
from exr import read_planes
from latlong import mean_luminance
from numpy.typing import NDArray

PREFIX = "photo_"
"""Begins the name of every photographed light in a recipe, since formulas have names like `night` too."""

MAPS = (
    "apartment", "bridge", "city", "dawn", "esplanade", "forest", "hall", "lab", "lobby", "night", "park", "sky", "studio",
    "sunrise", "sunset", "venice", "warehouse", "workshop",
)  # fmt: skip

NEVER_FOR_TRAINING = ("apartment", "city", "sky", "esplanade", "studio", "venice", "workshop")
"""Maps that light scenes which are scored. A prior that has seen one of them has seen the answer: never train on them."""

DAMAGED = ("park", "sunrise")
"""Maps whose sun kept its blue alone: no use as lights."""

PACKAGE = "@pmndrs/assets@1.7.0"
FILE = "pmndrs-assets-1.7.0.tgz"
SHA256 = "152bd218a3390703f184f0c6ce16e73c8f0a87f32d38530d418a09d33d8208dc"
CACHE = Path(__file__).resolve().parents[2] / "results" / "downloads"
"""Where the package is kept, below a checkout's results."""

LEAD = b"export default 'data:application/exr;base64,"


def fetch(folder: Path = CACHE, sha256: str = SHA256) -> Path:
    """The package's file in `folder`, fetched by npm where it is not there yet, and checked.

    Raises:
        ValueError: if it cannot be had or is another file; the message says what to do.
    """
    path = folder / FILE
    if not path.exists():
        _pack(path)
    found = hashlib.sha256(path.read_bytes()).hexdigest()
    if found != sha256:
        raise ValueError(f"{path}: expected {PACKAGE} with sha256 {sha256}, found {found}; remove the file and run this again")
    return path


def _pack(path: Path) -> None:
    """Fetch the package to `path`, which is whole or absent whenever this is stopped."""
    npm = shutil.which("npm")
    if npm is None:
        raise ValueError(f"photographed lights need npm, which was not found: install Node.js, or put {PACKAGE} at {path}")
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        done = subprocess.run([npm, "pack", PACKAGE, "--loglevel=error"], cwd=folder, capture_output=True, text=True, check=False)
        made = Path(folder) / FILE
        if done.returncode or not made.exists():
            reason = (done.stderr.strip().splitlines() or ["it made no file"])[0]
            raise ValueError(f"npm pack {PACKAGE} failed ({reason}): run it where there is a network, and put {FILE} at {path}")
        made.replace(path)


def read_map(package: Path, name: str) -> NDArray[np.float32]:
    """Map (H, 2H, 3) of the package as it is, row 0 = +z; negative values are still there.

    Raises:
        ValueError: if the package has no such map, or not in the form that is expected.
    """
    member = f"package/hdri/{name}.exr.js"
    with tarfile.open(package) as tar:
        try:
            file = tar.extractfile(member)
        except KeyError:
            file = None
        if file is None:
            raise ValueError(f"photographed light must be one of {', '.join(MAPS)}, got {name!r}")
        script = file.read()
    if not script.startswith(LEAD):
        raise ValueError(f"{package}: {member}: expected a script that starts with {LEAD.decode()}, got {script[:60]!r}")
    encoded = script.removeprefix(LEAD).partition(b"'")[0]
    with tempfile.TemporaryDirectory() as folder:  # OpenEXR reads files, not bytes
        path = Path(folder) / "map.exr"
        path.write_bytes(base64.b64decode(encoded, validate=True))
        planes = read_planes(path)
    image = np.stack([planes[channel] for channel in "RGB"], axis=-1).astype(np.float32)
    if image.shape[1] != 2 * image.shape[0] or not np.isfinite(image).all():
        raise ValueError(f"{package}: {member}: expected a finite map (H, 2H, 3), got {image.shape}")
    return image


def clamp(image: NDArray[np.float32]) -> tuple[NDArray[np.float32], float]:
    """The map with its negative values made 0, and the share of its energy (luminance over the sphere) that this added."""
    clamped = np.maximum(image, 0)
    return clamped, 1 - mean_luminance(image) / mean_luminance(clamped)


def resample(light: NDArray[np.floating], height: int) -> NDArray[np.float64]:
    """Light (height, 2 height, 3) whose texels are the exact means of a light (H, 2H, 3) over their solid angles.

    Radiance is constant inside a texel and a texel is a rectangle in (cos theta, phi), on which solid angle is area, so
    the mean is a product of overlaps. Energy is kept in every region that is whole texels of both.
    """
    rows = overlaps(np.cos(np.pi * np.arange(light.shape[0] + 1) / light.shape[0]), np.cos(np.pi * np.arange(height + 1) / height))
    columns = overlaps(np.linspace(1, -1, light.shape[1] + 1), np.linspace(1, -1, 2 * height + 1))
    return np.einsum("ij,jkc,lk->ilc", rows, light.astype(np.float64), columns, optimize=True)


def overlaps(source: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share (T, S) of each target interval that lies in each source interval, from falling edges (S + 1,) and (T + 1,)."""
    top = np.minimum(source[None, :-1], target[:-1, None])
    bottom = np.maximum(source[None, 1:], target[1:, None])
    return np.asarray(np.maximum(top - bottom, 0) / (target[:-1] - target[1:])[:, None])


def photographed_light(name: str, height: int, brightness: float, package: Path | None = None) -> NDArray[np.float32]:
    """Light (height, 2 height, 3) of the map `name`, clamped, resampled, and scaled to mean luminance `brightness`.

    Raises:
        ValueError: if there is no such map, its sun is damaged, or the package cannot be had.
    """
    if name in DAMAGED:
        raise ValueError(f"the map {name!r} lost the red and the green of its sun; take another")
    light = resample(clamp(read_map(package or fetch(), name))[0], height)
    return (light * (brightness / mean_luminance(light))).astype(np.float32)


def main() -> None:
    """Print a row for every map: clamped energy, lowest value, and the peak relative to the mean."""
    package = fetch()
    print(f"{'map':<10} {'negative':>9} {'lowest':>9} {'added':>7} {'peak / mean':>12} {'red / blue':>11}")
    for name in MAPS:
        image = read_map(package, name)
        clamped, added = clamp(image)
        peak = resample(clamped, clamped.shape[0]).mean(axis=-1).max() / mean_luminance(clamped)
        red, _, blue = resample(clamped, 1).mean(axis=(0, 1))
        negative = (image < 0).any(axis=-1).mean()
        print(f"{name:<10} {negative:>9.2%} {image.min():>9.1f} {added:>7.2%} {peak:>12.0f} {red / blue:>11.2f}")


if __name__ == "__main__":
    try:
        main()
    except ValueError as error:
        sys.exit(str(error))
