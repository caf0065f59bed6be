"""Texture coordinates by xatlas, which runs in a process of its own: some meshes make it crash, or never end.

``python -m ia_bench.geometry.unwrapping`` is that process: arrays come on standard input and go to standard output.
"""

from __future__ import annotations

import io
import subprocess
import sys

import numpy as np

from ia_bench.common.errors import InputError, printable
from ia_bench.scenes.scene import Mesh

SMALL, LARGE = 0.5, 1e6  # scene units: xatlas has fixed limits of areas, so that objects beyond these are scaled to a unit cube
AWAY = 10  # sizes of an object from the origin, from which on it is moved there: xatlas computes in single precision
LOST = 0.01  # of the triangles, for which xatlas has no place in the texture, from which on it is given a larger object
LEAST = 1e-6  # area of a triangle that xatlas does not take for none
SECONDS = 3600  # until it is taken to have hung
ELSEWHERE = "give it texture coordinates with another program"


def unwrap(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> Mesh:
    """The triangles with texture coordinates made by xatlas; vertices (V, 3) on its seams appear once per side.

    Raises InputError where xatlas crashes, does not end, or finds no finite coordinates, or none for a part of the triangles.
    """
    extent = float(np.ptp(vertices, axis=0).max())
    scale = 1.0 if SMALL <= extent <= LARGE or extent <= 0 else 1 / extent
    middle = 0.5 * (vertices.min(0) + vertices.max(0))
    near = vertices - middle if np.linalg.norm(middle) > AWAY * extent else vertices
    source, made, uv = _charts(scale * near, faces, normals)
    if (lost := _lost(made, uv)) > LOST:  # fine detail of an object: the least triangle decides, as far as the whole allows
        corners = near[faces]
        areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        scale = min(float(np.sqrt(LEAST / areas[areas > 0].min())), LARGE / extent)
        source, made, uv = _charts(scale * near, faces, normals)
        lost = _lost(made, uv)
    if not np.isfinite(uv).all() or lost > LOST:
        found = f"none for {lost:.1%} of {len(made)}" if np.isfinite(uv).all() else "NaN or Inf"
        raise InputError(
            f"xatlas: expected texture coordinates of all triangles, found {found}; they are too small beside the mesh's longest "
            f"side of {extent:.3g}: {ELSEWHERE}"
        )
    return Mesh(
        vertices=vertices[source].astype(np.float32),
        faces=made.astype(np.int32),
        normals=normals[source].astype(np.float32),
        uv=np.asarray(uv, np.float32).clip(0, 1),
    )


def _lost(faces: np.ndarray, uv: np.ndarray) -> float:
    """The share of triangles (F, 3) without an area in texture coordinates (V, 2)."""
    first, second, third = uv[faces].astype(np.float64).swapaxes(0, 1)
    with np.errstate(invalid="ignore"):  # of coordinates that are none
        return float((np.linalg.det(np.stack([second - first, third - first], 1)) == 0).mean())


def _charts(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What xatlas makes of them: for each of its vertices which one it was, (N,), its faces (F, 3), and coordinates (N, 2)."""
    given = io.BytesIO()
    np.savez(given, vertices=vertices.astype(np.float32), faces=faces.astype(np.uint32), normals=normals.astype(np.float32))
    command = [sys.executable, "-m", __name__]
    try:
        done = subprocess.run(command, input=given.getvalue(), capture_output=True, timeout=SECONDS, check=False)
    except subprocess.TimeoutExpired:
        raise InputError(f"xatlas: {len(faces)} triangles take it more than {SECONDS} s; {ELSEWHERE}") from None
    if done.returncode:
        why = f"exit status {done.returncode}"
        if done.returncode > 0:  # by Python and not by a signal: what it says last
            why = printable(done.stderr.decode(errors="replace").strip().split("\n")[-1])
        raise InputError(f"xatlas: crashes on these {len(faces)} triangles ({why}); {ELSEWHERE}")
    with np.load(io.BytesIO(done.stdout)) as made:
        return made["source"], made["faces"], made["uv"]


def main() -> None:
    """Unwrap what comes on standard input."""
    import xatlas

    with np.load(io.BytesIO(sys.stdin.buffer.read())) as given:
        atlas = xatlas.Atlas()
        atlas.add_mesh(given["vertices"], given["faces"], given["normals"])
    options = xatlas.PackOptions()
    options.padding, options.resolution, options.bilinear = 2, 1024, True
    atlas.generate(pack_options=options)
    made = io.BytesIO()
    np.savez(made, **dict(zip(("source", "faces", "uv"), atlas[0], strict=True)))
    sys.stdout.buffer.write(made.getvalue())


if __name__ == "__main__":
    main()
