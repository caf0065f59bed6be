"""What every reader of other people's data does alike: its options, its mesh, which views it keeps, and what it warns of."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Literal, TypeVar

import numpy as np
from scipy.ndimage import uniform_filter

from ia_bench.common.errors import InputError
from ia_bench.common.files import user_path
from ia_bench.geometry.mesh import load_mesh
from ia_bench.readers.cameras import expect_looking_at_object
from ia_bench.readers.contract import MESHES, NO_MESH
from ia_bench.readers.pictures import SUFFIXES, Notes
from ia_bench.scenes.scene import Mesh, Scene, Truth, View

T = TypeVar("T")
DATA = (*SUFFIXES, ".hdr", ".json", ".txt", ".npy", ".npz", ".bin", ".ply", ".obj", ".mtl", ".glb", ".gltf")
"""Suffixes, in lower case, of the files that readers open."""

SELDOM = 1000  # photographs, of which one is held out


@dataclass(frozen=True, kw_only=True)
class FolderReader:
    """A reader of the folder ``path``. A format is a subclass: its own options are fields, and ``read`` returns a Scene.

    Attributes:
        path: The folder that ``scene.path`` names.
        mesh: A mesh file, for datasets that have none or another one; None takes the folder's own.
        uv: "mesh" uses the texture coordinates of the mesh file, "xatlas" makes new ones.
        shrink: Side of the blocks of pixels that are averaged into one.
        held_out: How many held-out cameras are kept, spread evenly; None keeps all.
    """

    format: ClassVar[str]
    path: Path | None = field(kw_only=False)
    mesh: str | None = None
    uv: Literal["mesh", "xatlas"] = "mesh"
    shrink: int = 1
    held_out: int | None = None

    def __post_init__(self) -> None:
        """Check the options. Raises InputError for no folder, and for numbers below 1."""
        if self.path is None:
            raise InputError(f"reader={self.format}: expected scene.path=FOLDER, found none")
        for key in ("shrink", "held_out"):
            value = getattr(self, key)
            if value is not None and value < 1:
                raise InputError(f"reader.options.{key}: expected 1 or more, found {value}")

    @property
    def folder(self) -> Path:
        """The folder that is read."""
        assert self.path is not None
        return self.path

    @property
    def label(self) -> str:
        """What tables call the scene: the name of its folder, unless a format knows a better one."""
        return self.folder.name

    # ---------------------------------------------------------------- which files
    def places(self) -> Sequence[Path]:
        """Files and folders below which everything may be read, of which a run is known; by default all of the folder."""
        return [self.folder]

    def files(self) -> list[Path]:
        """The files that decide what is read, in order: those of :meth:`places`, and those that options name."""
        given = [getattr(self, option, None) for option in ("mesh", "lights")]
        named = [Path(text).expanduser().absolute() for text in given if text is not None]
        found = {path for place in (*self.places(), *named) for path in ([place] if place.is_file() else place.rglob("*"))}
        return sorted(path for path in found if path.suffix.lower() in DATA and path.is_file())

    # ---------------------------------------------------------------- which views
    def kept(self, items: Sequence[T]) -> list[T]:
        """Those of the held-out cameras that are kept."""
        return evenly(items, self.held_out)

    def view(self, view: View) -> View:
        """The view at the size that was asked for. Raises InputError where nothing is left of it."""
        smaller = min(view.camera.height, view.camera.width)
        if self.shrink > smaller:
            raise InputError(f"reader.options.shrink: expected at most {smaller}, found {self.shrink}")
        return view.scaled(self.shrink)

    def divided(self, count: int, every: int, view: Callable[[int], View]) -> tuple[list[View], list[View]]:
        """Training views and held-out views, the ``every``-th ones from the first on, of ``count`` photographs."""
        expect_every(every)
        held_out, training = self.kept(range(0, count, every)), [place for place in range(count) if place % every]
        if len(training) < 2:
            raise InputError(f"{self.folder}: expected at least 4 photographs, found {count}")
        return [self.view(view(place)) for place in training], [self.view(view(place)) for place in held_out]

    # ---------------------------------------------------------------- the scene
    def scene(
        self,
        *,
        train: Sequence[View],
        test: Sequence[View] = (),
        novel: Sequence[View],
        truth: Truth | None = None,
        notes: Notes,
        mesh: Path | None = None,
        place: np.ndarray | None = None,
    ) -> Scene:
        """The scene of these views. ``mesh`` is the one that comes with the data, where there is one.

        ``place`` (4, 4), a rotation, one scale and a translation, brings a mesh to where the cameras see it.

        Raises InputError where there is no training view, and where cameras look away from what they surround.
        """
        source = f"{self.format} {self.folder}"
        if not train:
            raise InputError(f"{source}: expected at least one training view, found none")
        expect_looking_at_object(source, train)
        path = mesh or next((there for name in MESHES if (there := self.folder / name).is_file()), None)
        path = path if self.mesh is None else user_path("reader.options.mesh", self.mesh)
        loaded, repairs = load_mesh(path, uv=self.uv) if path is not None else (None, (NO_MESH,))
        return Scene(
            name=self.label,
            source=source,
            mesh=loaded if loaded is None or place is None else placed(loaded, place),
            train=tuple(train),
            test=tuple(map(_held_out, test)),
            novel=tuple(map(_held_out, novel)),
            truth=truth,
            notes=(*repairs, *notes, *warnings_of(train, own_alpha=notes.own_alpha)),
        )


def expect_every(every: int) -> None:
    """Raise InputError unless every so many-th photograph can be held out, and the others fitted."""
    if not 2 <= every <= SELDOM:
        raise InputError(f"reader.options.every: expected 2 to {SELDOM}, found {every}")


def evenly(items: Sequence[T], count: int | None) -> list[T]:
    """``count`` of the ``items``, spread evenly and in their order; those of a smaller count are among those of a larger one.

    They are taken in the order of van der Corput's sequence (each next one halves the largest gap). None takes all.
    """
    if count is None or count >= len(items):
        return list(items)
    bits = max(1, (len(items) - 1).bit_length())
    order = (int(format(number, f"0{bits}b")[::-1], 2) for number in range(2**bits))
    return [items[place] for place in sorted([place for place in order if place < len(items)][:count])]


def _held_out(view: View) -> View:
    """The view with saturated pixels taken for known, since scores clip both images; what nobody has seen stays unknown."""
    known = view.known | (view.mask > 0)
    return replace(view, valid=None if known.all() else known)


def placed(mesh: Mesh, place: np.ndarray) -> Mesh:
    """The mesh moved by a rotation, one scale and a translation (4, 4)."""
    turned = place[:3, :3] / np.cbrt(np.linalg.det(place[:3, :3]))
    vertices = mesh.vertices @ place[:3, :3].T + place[:3, 3]
    return replace(mesh, vertices=vertices.astype(np.float32), normals=(mesh.normals @ turned.T).astype(np.float32))


# ---------------------------------------------------------------- signs in the pixels that a dataset is not what its format says
# Each is a number that sound images hardly have; tests/readers/test_opened_pictures.py measures what the shipped scenes have.
SOLID, EDGE = 0.95, (0.1, 0.5)  # coverages: of pixels inside the object, and of those whose colour alpha decides
LEAST_PIXELS = 100  # of an edge; fewer prove nothing
FADED, GLARING = 0.5, 2.0  # colour of edges over colour beside them; 1 is right, about .3 and 3 are alpha once too often or seldom
HALF = 2.0**-11  # relative rounding of half floats


def warnings_of(views: Sequence[View], *, own_alpha: bool = True) -> Iterator[str]:
    """One line for every sign that the training ``views`` show.

    Without ``own_alpha``, where masks lie in files of their own, edges of photographs show the background, and prove nothing.
    """
    ratio = edge_colour(views) if own_alpha else None
    if ratio is not None and not FADED <= ratio <= GLARING:
        cause = "to be multiplied by alpha twice (PNG files are expected to hold straight alpha)"
        if ratio > GLARING:
            cause = "not to be multiplied by alpha (OpenEXR files are expected to be premultiplied)"
        found = f"half-covered pixels are {ratio:.2f} times as bright as the object beside them"
        yield f"warning: {found}: the colours seem {cause}"
    if in_eight_bits(views):
        yield "warning: the linear images hold 8-bit steps from 0 to 1 only: they seem to be sRGB pictures stored as linear"


def edge_colour(views: Sequence[View]) -> float | None:
    """Mean colour of half-covered pixels, divided by alpha, over that of solid pixels beside them; None for too few of them."""
    edge, beside, count = 0.0, 0.0, 0
    for view in views:
        solid, grey = (view.mask > SOLID).astype(np.float32), view.image.mean(-1)
        near = uniform_filter(solid, 5)
        colour = uniform_filter(grey * solid, 5) / np.maximum(near, 1e-6)
        chosen = (view.mask > EDGE[0]) & (view.mask < EDGE[1]) & (near > 0.1)
        edge += float((grey[chosen] / view.mask[chosen]).sum())
        beside += float(colour[chosen].sum())
        count += int(chosen.sum())
    return edge / beside if count >= LEAST_PIXELS and beside > 0 else None


def in_eight_bits(views: Sequence[View]) -> bool:
    """Whether every solid pixel of all views is a multiple of 1/255 up to 1, in many different steps."""
    values = np.unique(np.concatenate([view.image[view.mask >= 1].ravel() for view in views]))
    if not 16 <= len(values) <= 256 or values[-1] > 1:
        return False
    steps = 255 * values.astype(np.float64)
    return bool((np.abs(steps - np.round(steps)) <= HALF * steps + 1e-3).all())
