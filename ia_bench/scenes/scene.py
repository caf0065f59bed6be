"""What is reconstructed: posed views of one object, its mesh, and (for scoring only) the truth behind them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np


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
    The fields below are ground truth (premultiplied by coverage, like the image), None unless they were asked for:
    ``albedo`` (H, W, 3), ``roughness`` (H, W), ``specular`` (H, W, 3) radiance, ``normal`` (H, W, 3) world space, ``depth`` (H, W).
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


@dataclass(frozen=True)
class Truth:
    """Ground truth of a whole scene: ``lights`` name -> (H, W, 3) radiance; textures are linear, (T, T, 3) and (T, T)."""

    lights: dict[str, np.ndarray]
    albedo: np.ndarray | None = None
    roughness: np.ndarray | None = None


@dataclass(frozen=True)
class Scene:
    """A mesh and its views by split, as a :class:`ia_bench.readers.contract.SceneReader` returns it.

    Attributes:
        name: What tables and pictures call it.
        source: Where it was read from, in words; messages begin with it.
        mesh: The object.
        train: The views that a method may fit.
        test: Held-out views, with the truth that maps are scored against.
        novel: Views that renders are scored against, of the training light ("train") and of lights that no method has seen.
        truth: None unless it was asked for, and in the scene that methods are given (see :meth:`blind`).
        notes: Repairs made while reading, one line each.
        metallic: Whether the scene's description says that parts of the object are metal.
    """

    name: str
    source: str
    mesh: Mesh
    train: tuple[View, ...]
    test: tuple[View, ...] = ()
    novel: tuple[View, ...] = ()
    truth: Truth | None = None
    notes: tuple[str, ...] = field(default=())
    metallic: bool = False

    def blind(self) -> Scene:
        """The scene as methods and priors see it: the mesh, and the training images, masks and cameras.

        All arrays are copies, and no text names a file: nothing in it leads to truth, and nothing done to it reaches the scorer.
        """
        mesh = Mesh(*(part.copy() for part in (self.mesh.vertices, self.mesh.faces, self.mesh.normals, self.mesh.uv)))
        views = tuple(
            View(v.name, replace(v.camera, to_world=v.camera.to_world.copy()), v.image.copy(), v.mask.copy(), v.light)
            for v in self.train
        )
        return Scene(self.name, f"scene {self.name}", mesh, views, metallic=self.metallic)
