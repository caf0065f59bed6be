"""What is reconstructed: posed views of one object, its mesh, and (for scoring only) the truth behind them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.scenes.turning import TurningLight

if TYPE_CHECKING:
    from torch import Tensor

Array = TypeVar("Array", np.ndarray, "Tensor")

OPENCV_AXES = np.diag([1.0, -1.0, -1.0, 1.0])
"""Turns OpenCV's axes (+z forward, +y down) into OpenGL's (-z forward, +y up), and back."""

FROM_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""Turns +y into +z, which points up here."""

CONVENTIONS: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "OpenCV's (+z forward, +y down)": lambda matrix: matrix @ OPENCV_AXES,
    "world-to-camera": np.linalg.inv,
    "OpenCV's world-to-camera": lambda matrix: np.linalg.inv(matrix) @ OPENCV_AXES,
}
"""What a matrix (4, 4) of others may be in place of :class:`Camera`'s -> what makes that of it."""


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

    def same_as(self, other: Mesh | None, *, uv: bool = False) -> bool:
        """Whether both have the same triangles, one by one, at the same places, to rounding; with ``uv`` also in the texture."""
        if other is None or self.faces.shape != other.faces.shape:
            return False
        size = 1e-5 * float(np.ptp(other.vertices, axis=0).max())
        pairs = [(self.vertices, other.vertices, size), *([(self.uv, other.uv, 1e-5)] if uv else [])]
        return all(np.allclose(own[self.faces], theirs[other.faces], rtol=0, atol=most) for own, theirs, most in pairs)


@dataclass(frozen=True)
class Camera:
    """A pinhole camera. ``to_world`` (4, 4) is OpenGL camera-to-world: it looks along its -z axis, +y is up in the image.

    ``focal`` (fx, fy) and ``centre`` (cx, cy) are in pixels. Places in the image are columns and rows, which count from the
    image's upper left corner: pixel (row, column) covers [column, column + 1] x [row, row + 1], its middle is at + .5.
    """

    to_world: np.ndarray
    focal: tuple[float, float]
    centre: tuple[float, float]
    width: int
    height: int

    @property
    def position(self) -> np.ndarray:
        """Where the camera is, (3,) in scene units."""
        return self.to_world[:3, 3]

    def project(self, points: Array) -> tuple[Array, Array, Array]:
        """Columns and rows in pixels, and depths along the axis in scene units, (N,) each, of (N, 3) points of the world.

        Points whose depth is not above 0 are not seen, and their columns and rows mean nothing. Tensors keep their type.
        """
        to_world: Any = self.to_world if isinstance(points, np.ndarray) else points.new_tensor(self.to_world)
        local = (points - to_world[:3, 3]) @ to_world[:3, :3]
        depth = -local[:, 2]
        safe = abs(depth) + (depth == 0)
        column = self.centre[0] + self.focal[0] * local[:, 0] / safe
        row = self.centre[1] - self.focal[1] * local[:, 1] / safe
        return column, row, depth

    def rays(self, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Directions (..., 3) through places (...) of the image: position + depth * direction is the point at that depth."""
        x, y = (columns - self.centre[0]) / self.focal[0], -(rows - self.centre[1]) / self.focal[1]
        directions: np.ndarray = np.stack([x, y, np.full(np.shape(x), -1.0)], -1) @ self.to_world[:3, :3].T
        return directions

    def scaled(self, block: int) -> Camera:
        """The camera whose pixels are ``block`` x ``block`` of this one's; incomplete blocks at the edges are left out."""
        focal, centre = ((pair[0] / block, pair[1] / block) for pair in (self.focal, self.centre))
        return replace(self, focal=focal, centre=centre, width=self.width // block, height=self.height // block)


@dataclass(frozen=True)
class View:
    """One photograph: linear Rec.709 radiance premultiplied by coverage, and what is known of it.

    ``image`` (H, W, 3) float32; ``mask`` (H, W) float32 coverage in [0, 1]; ``light`` names the light it was taken under.
    ``valid`` (H, W) bool, None where every pixel is known: where it is False, the image is a lower bound of the radiance, the
    clip where the sensor saturated and 0 where the pixel is unknown. If the mask is 0 there too, nobody knows whether the
    object is seen at all. ``exposure`` is the factor by which, as the camera recorded, the photograph shows radiance, in a unit
    that the views of a scene share; None where there is no record. ``taken`` is the size (H, W) of the photograph itself, at the
    upper left, where the view was :meth:`padded`.
    Ground truth, None unless it was asked for, premultiplied by coverage like the image: ``albedo`` (H, W, 3),
    ``roughness`` and ``metallic`` (H, W), ``specular`` (H, W, 3) radiance, ``normal`` (H, W, 3) world space, ``depth`` (H, W).
    """

    name: str
    camera: Camera
    image: np.ndarray
    mask: np.ndarray
    light: str = "train"
    albedo: np.ndarray | None = None
    roughness: np.ndarray | None = None
    metallic: np.ndarray | None = None
    specular: np.ndarray | None = None
    normal: np.ndarray | None = None
    depth: np.ndarray | None = None
    valid: np.ndarray | None = None
    exposure: float | None = None
    taken: tuple[int, int] | None = None

    @property
    def known(self) -> np.ndarray:
        """Which pixels are known, (H, W) bool: ``valid``, or all of them."""
        return np.ones(self.mask.shape, bool) if self.valid is None else self.valid

    @property
    def beyond(self) -> np.ndarray:
        """Pixels, (H, W) bool, of which nobody knows whether they show the object: beyond the photograph, as it were."""
        return ~self.known & (self.mask == 0)

    def _arrays(self) -> dict[str, np.ndarray]:
        return {part.name: value for part in fields(self) if isinstance(value := getattr(self, part.name), np.ndarray)}

    def scaled(self, block: int) -> View:
        """The view with the mean of every ``block`` x ``block`` pixels in place of them, as :meth:`Camera.scaled` has them.

        Everything in a view is premultiplied by coverage, so means of blocks are what a larger pixel would have seen. A block
        is ``valid`` where all of it is, and black, mask 0, where part of it is beyond the photograph: coverage that is not known
        is no outline.
        """
        if block == 1:
            return self
        camera = self.camera.scaled(block)
        height, width = camera.height, camera.width

        def mean(values: np.ndarray) -> np.ndarray:
            blocks = values[: height * block, : width * block].reshape(height, block, width, block, -1)
            return blocks.mean((1, 3), dtype=np.float64).astype(np.float32).reshape(height, width, *values.shape[2:])

        smaller: dict[str, Any] = {name: mean(values) for name, values in self._arrays().items()}
        if self.valid is not None:
            beyond = mean(self.beyond) > 0
            for values in smaller.values():
                values[beyond] = 0
            smaller["valid"] = smaller["valid"] == 1
        return replace(self, camera=camera, **smaller)

    def padded(self, height: int, width: int) -> View:
        """The view with pixels added at the right and at the bottom that are unknown: black, mask 0, not ``valid``.

        Pixels keep their places and so their rays.
        """
        if self.mask.shape == (height, width):
            return self
        more = (0, height - self.mask.shape[0]), (0, width - self.mask.shape[1]), (0, 0)
        arrays = self._arrays() | {"valid": self.known}
        larger: dict[str, Any] = {name: np.pad(values, more[: values.ndim]) for name, values in arrays.items()}
        taken = self.taken or self.mask.shape
        return replace(self, camera=replace(self.camera, height=height, width=width), taken=taken, **larger)


def of_one_size(views: Sequence[View]) -> tuple[View, ...]:
    """The same photographs, padded to the largest height and width among them, which is what fits and priors take."""
    height, width = (max(sizes) for sizes in zip(*(view.mask.shape for view in views), strict=True))
    return tuple(view.padded(height, width) for view in views)


def farthest_first(views: Sequence[View], middle: np.ndarray) -> list[int]:
    """All views by number, the first one first; every next one is that whose direction is farthest from all before it.

    Directions are those from the point ``middle`` (3,) to the cameras: farthest-point sampling (Gonzalez 1985).
    """
    directions = np.stack([view.camera.position for view in views]) - middle
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)
    order = [0]
    nearest = directions @ directions[0]  # cosine to the nearest direction that is taken
    while len(order) < len(views):
        nearest[order] = np.inf
        order.append(int(nearest.argmin()))
        nearest = np.maximum(nearest, directions @ directions[order[-1]])
    return order


@dataclass(frozen=True)
class Truth:
    """Ground truth of a whole scene: ``lights`` name -> (H, W, 3) radiance; textures are linear, albedo (T, T, 3), others (T, T).

    ``mesh`` is the true one, to which the textures belong, where a capture or new texture coordinates have put another one into its
    place; else None.
    """

    lights: dict[str, np.ndarray]
    albedo: np.ndarray | None = None
    roughness: np.ndarray | None = None
    metallic: np.ndarray | None = None
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
        metallic: Whether the scene's description says that parts of the object are metal; None where it does not say.
        exposures_differ: Whether every training image may have been multiplied by a factor of its own, which nobody knows; the
            geometric mean of these factors is 1.
        white_balances_differ: Whether these factors are three an image, one a channel; the exposures then differ, too.
        mesh_is_made: Whether the mesh is no part of what was read, but was made for this capture.
        saturated_share: The part of the object's pixels in the training views, from 0 to 1, that this capture has clipped.
        turning: How the training light turns with the camera; None where it stands still.
    """

    name: str
    source: str
    mesh: Mesh | None
    train: tuple[View, ...]
    test: tuple[View, ...] = ()
    novel: tuple[View, ...] = ()
    truth: Truth | None = None
    notes: tuple[str, ...] = ()
    metallic: bool | None = None
    exposures_differ: bool = False
    white_balances_differ: bool = False
    mesh_is_made: bool = False
    saturated_share: float = 0.0
    turning: TurningLight | None = None

    def blind(self) -> Scene:
        """The scene as methods and priors see it: the mesh, and the training images, masks and cameras.

        All arrays are copies, and no text names a file: nothing in it leads to truth, and nothing done to it reaches the scorer.
        """
        given = self.mesh
        mesh = given and Mesh(*(part.copy() for part in (given.vertices, given.faces, given.normals, given.uv)))
        views = list[View]()
        for view in self.train:
            camera = replace(view.camera, to_world=view.camera.to_world.copy())
            valid = None if view.valid is None else view.valid.copy()
            views.append(View(view.name, camera, view.image.copy(), view.mask.copy(), view.light, valid=valid))
        said = "metallic", "exposures_differ", "white_balances_differ", "turning"
        known: dict[str, Any] = {name: getattr(self, name) for name in said}
        return Scene(self.name, f"scene {self.name}", mesh, tuple(views), **known)

    def expect_mesh(self) -> Mesh:
        """The mesh. Raises InputError where there is none."""
        if self.mesh is None:
            raise InputError(f"{self.source}: expected a mesh, found none")
        return self.mesh
