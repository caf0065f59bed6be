"""Writers of formats with calibrated cameras: IDR's (DTU), COLMAP's text, LLFF's and NeILF's."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial.transform import Rotation

from ia_bench.readers.writers.parts import (
    Options,
    expect_central,
    intrinsics,
    lit_and_held_out,
    mixed,
    save_bare_photo,
    save_exr,
    save_json,
    save_obj,
    save_png,
    save_truth,
    world_to_camera,
)
from ia_bench.scenes.images import straight
from ia_bench.scenes.scene import FROM_Y_UP, Camera, Mesh, Scene, View

SIZE, MIDDLE = 40.0, np.array([100.0, -50.0, 600.0])  # where the units of DTU have the object: millimetres before the robot
BOX, CENTRE = 1.3, np.array([0.1, -0.2, 0.3])  # where the units of NeILF have it, in a box of this half side
POINTS = 20_000  # of COLMAP's sparse model, at most


def write_dtu(folder: Path, scene: Scene) -> Options:
    """Photographs and masks by number, and cameras.npz; the mesh is in millimetres."""
    scale = np.diag([SIZE, SIZE, SIZE, 1.0])
    scale[:3, 3] = MIDDLE
    views, options = mixed(scene)
    matrices = dict[str, Any]()
    for number, view in enumerate(views):
        save_bare_photo(folder / "image" / _numbered(number, views), view)
        save_png(folder / "mask" / _numbered(number, views), np.stack([view.mask] * 3, -1))
        projection = intrinsics(view.camera, 0.0) @ world_to_camera(view.camera, SIZE, MIDDLE)
        matrices[f"world_mat_{number}"] = np.vstack([projection, [0, 0, 0, 1]])
        matrices[f"scale_mat_{number}"] = scale
        for kind in ("world", "scale"):
            matrices[f"{kind}_mat_inv_{number}"] = np.linalg.inv(matrices[f"{kind}_mat_{number}"])
    np.savez(folder / "cameras.npz", **matrices)
    save_obj(folder / "mesh.obj", scene, scale)
    return options


def write_colmap(folder: Path, scene: Scene) -> Options:
    """A sparse model in text whose points are vertices of the mesh; photographs and masks under COLMAP's names."""
    views, options = mixed(scene)
    images, cameras, sparse = [], dict[tuple[float, ...], int](), folder / "sparse" / "0"
    sparse.mkdir(parents=True)
    for number, view in enumerate(views, 1):
        name, camera = f"{number:04}.png", view.camera
        save_bare_photo(folder / "images" / name, view)
        save_png(folder / "masks" / f"{name}.png", view.mask)
        to_camera = world_to_camera(camera)
        x, y, z, w = Rotation.from_matrix(to_camera[:, :3]).as_quat()
        lens = cameras.setdefault((camera.width, camera.height, *camera.focal, *camera.centre), len(cameras) + 1)
        images.append(f"{number} {_row(w, x, y, z, *to_camera[:, 3])} {lens} {name}\n\n")
    lines = [f"{number} PINHOLE {lens[0]} {lens[1]} {_row(*lens[2:])}\n" for lens, number in cameras.items()]
    vertices = scene.mesh.vertices if scene.mesh is not None else np.zeros((0, 3))
    points = vertices[:: max(-(-len(vertices) // POINTS), 1)]
    (sparse / "cameras.txt").write_text("".join(lines))
    (sparse / "images.txt").write_text("".join(images))
    (sparse / "points3D.txt").write_text("".join(f"{n} {_row(*point)} 128 128 128 0\n" for n, point in enumerate(points, 1)))
    save_obj(folder / "mesh.obj", scene)
    return options


def _numbered(number: int, views: Sequence[View]) -> str:
    """What a picture is called, so that names are in the order of their numbers."""
    return f"{number:0{max(3, len(str(len(views))))}}.png"


def _row(*values: float) -> str:
    return " ".join(repr(float(value)) for value in values)


def write_llff(folder: Path, scene: Scene) -> Options:
    """poses_bounds.npy has a row a photograph: [R | t | height, width, focal], axes down, right, backwards; nearest, farthest."""
    views, options = mixed(scene)
    expect_central("llff", views, alike=True)
    rows = []
    for number, view in enumerate(views):
        save_bare_photo(folder / "images" / _numbered(number, views), view)
        save_png(folder / "masks" / _numbered(number, views), view.mask)
        right, up, back, place = view.camera.to_world[:3].T
        size = view.camera.height, view.camera.width, view.camera.focal[0]
        points = scene.mesh.vertices.astype(float) if scene.mesh is not None else np.zeros((1, 3))
        depths = view.camera.project(points)[2]
        rows.append([*np.stack([-up, right, back, place, size], -1).ravel(), 0.9 * depths.min(), 1.1 * depths.max()])
    np.save(folder / "poses_bounds.npy", np.array(rows))
    save_obj(folder / "mesh.obj", scene)
    return options


def write_neilf(folder: Path, scene: Scene) -> Options:
    """Linear photographs, held-out ones first, positions of their pixels on the mesh, and sfm_scene.json; masks are binary."""
    mesh, others = scene.expect_mesh(), lit_and_held_out(scene)
    files, images = {}, {}
    for number, view in enumerate([*others, *scene.train]):
        name, covered = f"{number:03}", view.mask > 0.5
        save_exr(folder / "inputs" / "images" / f"{name}.exr", straight(view.image, view.mask))
        there = covered[..., None] * (BOX * positions(mesh, view.camera, covered) + CENTRE)
        save_exr(folder / "inputs" / "position_maps" / f"{name}.exr", there)
        extrinsic = np.vstack([world_to_camera(view.camera, BOX, CENTRE), [0, 0, 0, 1]]).ravel().tolist()
        camera = {"intrinsic": {"focal": list(view.camera.focal), "ppt": list(view.camera.centre)}, "extrinsic": extrinsic}
        files[str(number)] = f"images/{name}.exr"
        images[str(number)] = {"flg": 2, "size": [view.camera.width, view.camera.height], "camera": camera}
        truth = folder / "ground_truths" / "materials"
        save_truth(truth / "kd" / f"{name}.png", view.albedo, view.mask, alpha=False)
        save_truth(truth / "roughness" / f"{name}.png", view.roughness, view.mask, alpha=False)
    place, box = np.diag([BOX, BOX, BOX, 1.0]), np.diag([2 * BOX, 2 * BOX, 2 * BOX, 1.0])
    place[:3, 3] = box[:3, 3] = CENTRE
    about = {"image_path": {"file_paths": files}, "camera_track_map": {"images": images}}
    content = {**about, "bbox": {"transform": box.ravel().tolist()}}
    save_json(folder / "inputs" / "sfm_scene.json", content)
    save_obj(folder / "inputs" / "model" / "mesh.obj", scene, FROM_Y_UP.T @ place)  # its readers expect +y up
    return {"validation": list(range(len(others)))}


def positions(mesh: Mesh, camera: Camera, covered: np.ndarray) -> np.ndarray:
    """Where the rays through covered pixels (H, W) meet the mesh, (H, W, 3); elsewhere the place of the nearest that does."""
    import trimesh

    rows, columns = np.nonzero(covered)
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    ways = camera.rays(columns + 0.5, rows + 0.5)
    places, which, _ = solid.ray.intersects_location(np.tile(camera.position, (len(ways), 1)), ways, multiple_hits=False)
    found, hit = np.zeros((*covered.shape, 3), np.float32), np.zeros(covered.shape, bool)
    found[rows[which], columns[which]], hit[rows[which], columns[which]] = places, True
    if hit.any():
        nearest = distance_transform_edt(~hit, return_distances=False, return_indices=True)
        found = found[nearest[0], nearest[1]]
    return found
