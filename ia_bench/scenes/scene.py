"""What is reconstructed: posed views of one object, its mesh, and (for scoring only) the truth behind them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ia_bench.common.errors import InputError


@dataclass(frozen=True)
class Mesh:
    """Triangles with texture coordinates and shading normals.

    ``vertices`` (V, 3) float32; ``faces`` (F, 3) int32; ``normals`` (V, 3) float32, unit length;
    ``uv`` (V, 2) float32 in [0, 1], (0, 0) at the texture's lower-left corner. A vertex on a UV seam appears once per side.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    uv: np.ndarray


@dataclass(frozen=True)
class Camera:
    """A pinhole camera. ``to_world`` (4, 4) is OpenGL camera-to-world: it looks along its -z axis, +y is up in the image.

    ``focal`` (fx, fy) and ``centre`` (cx, cy) are in pixels; pixel (row, column) covers [column, column + 1] x [row, row + 1].
    """

    to_world: np.ndarray
    focal: tuple[float, float]
    centre: tuple[float, float]
    width: int
    height: int


@dataclass(frozen=True)
class View:
    """One photograph: linear Rec.709 radiance premultiplied by coverage, and what is known of it.

    ``image`` (H, W, 3) float32; ``mask`` (H, W) float32 coverage in [0, 1]; ``light`` names the light it was taken under.
    ``valid`` (H, W) bool, None where every pixel is known: where it is False, the image is a lower bound of the radiance, the
    clip where the sensor saturated and 0 where the pixel is unknown. If the mask is 0 there too, nobody knows whether the
    object is seen at all.
    Ground truth, None unless it was asked for, premultiplied by coverage like the image: ``albedo`` (H, W, 3),
    ``roughness`` (H, W), ``specular`` (H, W, 3) radiance, ``normal`` (H, W, 3) world space, ``depth`` (H, W).
    """

    name: str
    camera: Camera
    image: np.ndarray
    mask: np.ndarray
    light: str = "train"
    albedo: np.ndarray | None = None
    roughness: np.ndarray | None = None
    specular: np.ndarray | None = None
    normal: np.ndarray | None = None
    depth: np.ndarray | None = None
    valid: np.ndarray | None = None


@dataclass(frozen=True)
class Truth:
    """Ground truth of a whole scene: ``lights`` name -> (H, W, 3) radiance; textures are linear, (T, T, 3) and (T, T).

    ``mesh`` is the true one, to which the textures belong, where a capture has put another one into its place; else None.
    """

    lights: dict[str, np.ndarray]
    albedo: np.ndarray | None = None
    roughness: np.ndarray | None = None
    mesh: Mesh | None = None


@dataclass(frozen=True)
class Scene:
    """A mesh and its views by split, as a :class:`ia_bench.readers.contract.SceneReader` returns it.

    Attributes:
        name: What tables and pictures call it.
        source: Where it was read from, in words; messages begin with it.
        mesh: The object; None for a capture that has none.
        train: The views that a method may fit.
        test: Held-out views, with the truth that maps are scored against.
        novel: Views that renders are scored against, of the training light ("train") and of lights that no method has seen.
        truth: None unless it was asked for, and in the scene that methods are given (see :meth:`blind`).
        notes: Repairs made while reading, one line each.
        metallic: Whether the scene's description says that parts of the object are metal.
        exposures_differ: Whether every training image may have been multiplied by a factor of its own, which nobody knows; the
            geometric mean of these factors is 1.
        mesh_is_made: Whether the mesh is no part of what was read, but was made for this capture.
        saturated_share: The part of the object's pixels in the training views, from 0 to 1, that this capture has clipped.
    """

    name: str
    source: str
    mesh: Mesh | None
    train: tuple[View, ...]
    test: tuple[View, ...] = ()
    novel: tuple[View, ...] = ()
    truth: Truth | None = None
    notes: tuple[str, ...] = ()
    metallic: bool = False
    exposures_differ: bool = False
    mesh_is_made: bool = False
    saturated_share: float = 0.0

    def blind(self) -> Scene:
        """The scene as methods and priors see it: the mesh, and the training images, masks and cameras.

        All arrays are copies, and no text names a file: nothing in it leads to truth, and nothing done to it reaches the scorer.
        """
        given = self.mesh
        mesh = given and Mesh(*(part.copy() for part in (given.vertices, given.faces, given.normals, given.uv)))
        views, differ = tuple(map(_blind, self.train)), self.exposures_differ
        return Scene(self.name, f"scene {self.name}", mesh, views, metallic=self.metallic, exposures_differ=differ)

    def expect_mesh(self) -> Mesh:
        """The mesh. Raises InputError where there is none."""
        if self.mesh is None:
            raise InputError(f"{self.source}: expected a mesh, found none")
        return self.mesh


def _blind(view: View) -> View:
    camera = replace(view.camera, to_world=view.camera.to_world.copy())
    valid = None if view.valid is None else view.valid.copy()
    return View(view.name, camera, view.image.copy(), view.mask.copy(), view.light, valid=valid)
