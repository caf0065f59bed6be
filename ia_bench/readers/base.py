"""What every reader of other people's data does alike: its options, its mesh, and which views it keeps."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, ClassVar, Literal, TypeVar

import numpy as np
from pydantic import Field

from ia_bench.common.errors import InputError
from ia_bench.common.files import files_below, user_path
from ia_bench.geometry.mesh import load_mesh
from ia_bench.geometry.mesh_files import named_by_gltf
from ia_bench.readers.cameras import expect_looking_at_object
from ia_bench.readers.contract import MESHES, NO_MESH
from ia_bench.readers.lenses import places_of
from ia_bench.readers.pictures import SUFFIXES
from ia_bench.scenes.scene import Mesh, Scene, Truth, View

T = TypeVar("T")
DATA = (*SUFFIXES, ".hdr", ".json", ".txt", ".npy", ".npz", ".bin", ".ply", ".obj", ".mtl", ".glb", ".gltf")
"""Suffixes, in lower case, of the files that readers open."""


def spread(items: Sequence[T], most: int) -> list[T]:
    """So many of the items, spread evenly over all of them; all where there are no more."""
    count = min(most, len(items))
    return [items[place * len(items) // count] for place in range(count)]


@dataclass(frozen=True, kw_only=True)
class FolderReader:
    """A reader of the folder ``path``. A format is a subclass: its own options are fields, and ``read`` returns a Scene.

    Attributes:
        elsewhere: The options that name a file or folder as the command line does; those of all others lie below ``path``.
        path: The folder that ``scene.path`` names.
        mesh: A mesh file, for datasets that have none or another one; None takes the folder's own.
        uv: "mesh" uses the texture coordinates of the mesh file, "xatlas" makes new ones.
        shrink: Side of the blocks of pixels that are averaged into one.
        held_out: How many held-out cameras are kept, spread evenly; None keeps all.
    """

    format: ClassVar[str]
    elsewhere: ClassVar[tuple[str, ...]] = ("mesh", "lights")
    path: Path | None = field(kw_only=False)
    mesh: str | None = None
    uv: Literal["mesh", "xatlas"] = "mesh"
    shrink: Annotated[int, Field(ge=1)] = 1
    held_out: Annotated[int, Field(ge=1)] | None = None

    def __post_init__(self) -> None:
        """Raise InputError where no folder was given."""
        if self.path is None:
            raise InputError(f"reader={self.format}: expected scene.path=FOLDER, found none")

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
        """The files that decide what is read, in order: those of :meth:`places`, and those that options name and their buffers."""
        given = [getattr(self, option, None) for option in self.elsewhere]
        named = [Path(text).expanduser().absolute() for text in given if text is not None]
        named += [buffer for path in named for buffer in named_by_gltf(path, "buffers")]
        below = [self.folder / folder for option in ("images", "masks") if (folder := getattr(self, option, None))]
        found = {path for place in (*self.places(), *below, *named) for path in files_below(place)}
        return sorted(path for path in found if path in named or path.suffix.lower() in DATA)

    # ---------------------------------------------------------------- which views
    def kept(self, items: Sequence[T]) -> list[T]:
        """Those of the held-out cameras that are kept, spread evenly."""
        return spread(items, self.held_out or len(items))

    def with_true_albedo(self, items: Sequence[T], *files: Callable[[T], Path]) -> list[T]:
        """The held-out cameras for which one of these ``files`` of true albedo is there, or all cameras if it is for none."""
        return [item for item in items if any(file(item).is_file() for file in files)] or list(items)

    def view(self, view: View) -> View:
        """The view at the size that was asked for. Raises InputError where nothing is left of it."""
        smaller = min(view.camera.height, view.camera.width)
        if self.shrink > smaller:
            raise InputError(f"reader.options.shrink: expected at most {smaller}, found {self.shrink}")
        return view.scaled(self.shrink)

    # ---------------------------------------------------------------- the scene
    def scene(
        self,
        *,
        train: Sequence[View],
        test: Sequence[View] = (),
        novel: Sequence[View],
        truth: Truth | None = None,
        notes: Sequence[str] = (),
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
        places_of.cache_clear()  # all photographs are straight, and of large ones it is hundreds of megabytes
        path = mesh or next((there for name in MESHES if (there := self.folder / name).is_file()), None)
        path = path if self.mesh is None else user_path("reader.options.mesh", self.mesh)
        loaded, repairs = load_mesh(path, uv=self.uv) if path is not None else (None, (NO_MESH,))
        return Scene(
            name=self.label,
            source=source,
            mesh=loaded if loaded is None or place is None else _placed(loaded, place),
            train=tuple(train),
            test=tuple(map(_held_out, test)),
            novel=tuple(map(_held_out, novel)),
            truth=truth,
            notes=tuple(dict.fromkeys((*repairs, *notes))),
        )


@dataclass(frozen=True, kw_only=True)
class UnsplitReader(FolderReader):
    """A reader of photographs that may come in one list, with no truth.

    Attributes:
        every: Every so many-th photograph of a list is held out, from the first on.
    """

    every: Annotated[int, Field(ge=2, le=1000)] = 8

    def split(self, photographs: Sequence[T]) -> tuple[list[T], list[T]]:
        """The photographs to fit, and those that are held out."""
        training = [photograph for place, photograph in enumerate(photographs) if place % self.every]
        return training, list(photographs[:: self.every])

    def note_without_pose(self, posed: Iterable[object], notes: list[str], others: Iterable[object] = ()) -> None:
        """Tell ``notes`` how many pictures lie beside those that are ``posed`` and have no pose, for many programs place only some.

        All are names below the folder, with or without a suffix; ``others``, such as masks and depth maps, are no photographs.
        """
        names, beside = ({os.path.normpath(self.folder / str(name)) for name in some} for some in (posed, others))
        folders = {os.path.dirname(name) for name in names if self.folder in Path(name).parents}
        there = [path for folder in folders if os.path.isdir(folder) for path in Path(folder).iterdir()]
        known = {*names, *beside, *(os.path.splitext(name)[0] for name in names)}
        left = sorted(path.name for path in there if path.suffix.lower() in SUFFIXES and path.name[0] != "."
                      and not {str(path), str(path.with_suffix(""))} & known)  # fmt: skip
        if left:
            notes.append(f"{len(left)} picture(s) beside the photographs have no pose and are left out, {left[0]} first")

    def unsplit(self, count: int, view: Callable[[int], View], notes: list[str], place: np.ndarray | None = None) -> Scene:
        """The scene of ``count`` photographs, in their order; ``place`` as of :meth:`scene`. Raises InputError for too few."""
        training, held_out = self.split(range(count))
        if len(training) < 2:
            raise InputError(f"{self.folder}: expected at least {4 if self.every == 2 else 3} photographs, found {count}")
        train, test = ([self.view(view(number)) for number in numbers] for numbers in (training, self.kept(held_out)))
        return self.scene(train=train, test=test, novel=test, notes=notes, place=place)


def _held_out(view: View) -> View:
    """The view with saturated pixels taken for known, since scores clip both images; what nobody has seen stays unknown."""
    known = view.known | (view.mask > 0)
    return replace(view, valid=None if known.all() else known)


def _placed(mesh: Mesh, place: np.ndarray) -> Mesh:
    """The mesh moved by a rotation, one scale and a translation (4, 4)."""
    turned = place[:3, :3] / np.cbrt(np.linalg.det(place[:3, :3]))
    vertices = mesh.vertices @ place[:3, :3].T + place[:3, 3]
    return replace(mesh, vertices=vertices.astype(np.float32), normals=(mesh.normals @ turned.T).astype(np.float32))
