"""What every reader of other people's data does alike: its options, its mesh, which views it keeps, and what it warns of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.common.files import user_path
from ia_bench.geometry.mesh import load_mesh
from ia_bench.readers.contract import MESHES, NO_MESH
from ia_bench.readers.poses import expect_looking_at_object
from ia_bench.readers.signs import warnings_of
from ia_bench.readers.sizes import evenly, shrunk
from ia_bench.scenes.scene import Mesh, Scene, Truth, View

T = TypeVar("T")
Unwrapping = Literal["mesh", "xatlas"]


@dataclass(frozen=True)
class Intake:
    """The options that all readers share, checked, and what they do.

    Attributes:
        reader: The reader's name, for messages.
        folder: The folder that ``scene.path`` names.
        mesh: A mesh file, for datasets that have none or another one; None takes the folder's own.
        uv: "mesh" uses the texture coordinates of the mesh file, "xatlas" makes new ones.
        shrink: Side of the blocks of pixels that are averaged into one.
        held_out: How many held-out cameras are kept, spread evenly; None keeps all.
    """

    reader: str
    folder: Path
    mesh: str | None
    uv: Unwrapping
    shrink: int
    held_out: int | None

    @classmethod
    def of(cls, reader: str, path: Path | None, *, mesh: str | None, uv: Unwrapping, shrink: int, held_out: int | None) -> Intake:
        """The options of a reader that was made for ``path``. Raises InputError for no folder, and numbers below 1."""
        if path is None:
            raise InputError(f"reader={reader}: expected scene.path=FOLDER, found none")
        for key, value in (("shrink", shrink), ("held_out", held_out)):
            if value is not None and value < 1:
                raise InputError(f"reader.options.{key}: expected 1 or more, found {value}")
        return cls(reader, path, mesh, uv, shrink, held_out)

    def kept(self, items: Sequence[T]) -> list[T]:
        """Those of the held-out cameras that are kept."""
        return evenly(items, self.held_out)

    def view(self, view: View) -> View:
        """The view at the size that was asked for."""
        return shrunk(view, self.shrink)

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
        name: str | None = None,
    ) -> Scene:
        """The scene of these views. ``mesh`` is the one that comes with the data, where there is one.

        ``place`` (4, 4), a rotation, one scale and a translation, brings a mesh to where the cameras see it.

        Raises InputError where there is no training view, and where cameras look away from what they surround.
        """
        source = f"{self.reader} {self.folder}"
        if not train:
            raise InputError(f"{source}: expected at least one training view, found none")
        expect_looking_at_object(source, train)
        path = self._mesh_file(mesh)
        loaded, repairs = load_mesh(path, uv=self.uv) if path is not None else (None, (NO_MESH,))
        return Scene(
            name=name or self.folder.name,
            source=source,
            mesh=loaded if loaded is None or place is None else placed(loaded, place),
            train=tuple(train),
            test=tuple(map(_held_out, test)),
            novel=tuple(map(_held_out, novel)),
            truth=truth,
            notes=(*repairs, *notes, *warnings_of(train)),
        )

    def _mesh_file(self, own: Path | None) -> Path | None:
        if self.mesh is not None:
            return user_path("reader.options.mesh", self.mesh)
        return own or next((path for name in MESHES if (path := self.folder / name).is_file()), None)


def _held_out(view: View) -> View:
    """The view with saturated pixels taken for known, since scores clip both images; what nobody has seen stays unknown."""
    known = None if view.valid is None else view.valid | (view.mask > 0)
    return replace(view, valid=None if known is None or known.all() else known)


def placed(mesh: Mesh, place: np.ndarray) -> Mesh:
    """The mesh moved by a rotation, one scale and a translation (4, 4)."""
    turned = place[:3, :3] / np.cbrt(np.linalg.det(place[:3, :3]))
    vertices = mesh.vertices @ place[:3, :3].T + place[:3, 3]
    return replace(mesh, vertices=vertices.astype(np.float32), normals=(mesh.normals @ turned.T).astype(np.float32))
