"""An object that is turned before a camera and a light at rest, and the same object at rest while both go round it: one picture.

The first is rendered of a turned mesh by the renderer as it is, the second of a light that turns (``SampledLight.turning``).
Both draw the same samples, so they agree to rounding, but for the few rays that hit another triangle at an edge.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from shapes import camera_at, sphere, together
from stage import Stage

from ia_bench.capture.settings import CaptureSettings
from ia_bench.capture.turntable import fitted_circles, fitted_rounds, turning_light
from ia_bench.common.errors import InputError
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.render.turns import spread_turns
from ia_bench.scenes.scene import Camera, Mesh, View
from ia_bench.scenes.turning import Round, TurningLight

pytestmark = pytest.mark.usefixtures("own_cache")

AXIS = np.array([0.36, -0.48, 0.8])
ANGLES = (0.0, 0.7, 2.9, -1.4)


def rotation_about(axis: np.ndarray, angle: float) -> np.ndarray:
    return Rotation.from_rotvec(angle * axis).as_matrix()


def turned_mesh(mesh: Mesh, rotation: np.ndarray) -> Mesh:
    return replace(
        mesh, vertices=(mesh.vertices @ rotation.T).astype(np.float32), normals=(mesh.normals @ rotation.T).astype(np.float32)
    )


def turned_camera(camera: Camera, rotation: np.ndarray) -> Camera:
    to_world = camera.to_world.copy()
    to_world[:3] = rotation @ camera.to_world[:3]
    return replace(camera, to_world=to_world)


def turning_with(camera: Camera, axis: np.ndarray | None = AXIS) -> TurningLight:
    return TurningLight(tuple(map(tuple, camera.to_world[:3])), () if axis is None else (Round(tuple(axis)),))


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    """Two balls, one of which throws a shadow and light onto the other."""
    small = sphere(3, radius=0.5)
    moved = replace(small, vertices=(small.vertices + [1.2, 0.5, 0.6]).astype(np.float32))
    both = together(sphere(3), moved)
    around = both.normals
    uv = np.stack([0.5 + np.arctan2(around[:, 1], around[:, 0]) / (2 * math.pi), 0.5 + around[:, 2] / 2], 1)
    half = np.repeat([0.0, 0.5], [len(both.vertices) - len(moved.vertices), len(moved.vertices)])
    return replace(both, uv=np.stack([0.5 * uv[:, 0] + half, uv[:, 1]], 1).astype(np.float32))


@pytest.fixture(scope="module")
def light() -> torch.Tensor:
    return 3 * torch.rand(16, 32, 3, generator=torch.Generator().manual_seed(5)) ** 4


@pytest.fixture(scope="module")
def material() -> Material:
    rng = torch.Generator().manual_seed(6)
    return Material(0.1 + 0.8 * torch.rand(16, 16, 3, generator=rng), 0.1 + 0.8 * torch.rand(16, 16, 1, generator=rng))


def rendered(stage: Stage, material: Material, light: SampledLight, **settings: object) -> torch.Tensor:
    return stage.estimate(stage.every, material, light, 128, seed=1, **settings).radiance


def compared(mesh: Mesh, camera: Camera, rotation: np.ndarray) -> tuple[Stage, Stage, torch.Tensor]:
    """The turned mesh before the camera, the mesh before the turned camera, and which entries of both see the same triangles."""
    recipe = Stage(turned_mesh(mesh, rotation), [camera])
    moved = Stage(mesh, [turned_camera(camera, rotation.T)])
    assert torch.equal(recipe.seen.pixel, moved.seen.pixel)  # or else other samples are drawn
    same = (recipe.seen.face == moved.seen.face).all(1)
    assert same.float().mean() > 0.995
    return recipe, moved, same


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("fixed_to", ["axis", "camera"])
def test_a_turned_object_is_a_moved_camera_in_a_turned_light(mesh, light, material, angle, fixed_to):
    camera = camera_at((2.0, -3.0, 1.5), pixels=40)
    turning = turning_with(camera, AXIS if fixed_to == "axis" else None)
    rotation = rotation_about(AXIS, angle)
    recipe, moved, same = compared(mesh, camera, rotation)
    expected = rendered(recipe, material, SampledLight.of(light))[same]
    found = rendered(moved, material, SampledLight.of(light, turning=turning))[same]
    worst = (found - expected).abs().amax(1)
    assert worst.quantile(0.99) < 1e-4, f"{worst.max():.2g}"
    assert (found - expected).abs().mean() < 1e-4 * expected.mean()
    if angle:
        static = rendered(moved, material, SampledLight.of(light))[same]
        assert (static - expected).abs().mean() > 0.05 * expected.mean()


def test_light_that_the_object_throws_onto_itself_turns_too(mesh, light, material):
    camera, rotation = camera_at((2.0, -3.0, 1.5), pixels=40), rotation_about(AXIS, 2.0)
    turning = turning_with(camera)
    recipe, moved, same = compared(mesh, camera, rotation)
    parts = [
        rendered(stage, material, lit, bounces=2)
        for stage, lit in ((recipe, SampledLight.of(light)), (moved, SampledLight.of(light, turning=turning)))
    ]
    direct = rendered(moved, material, SampledLight.of(light, turning=turning))
    expected, found = ((part - direct)[same] for part in parts)
    assert float((found - expected).abs().mean() / expected.mean()) < 0.1  # rays and cells of the sky differ


def test_views_see_their_own_turn_whether_they_are_rendered_alone_or_together(mesh, light, material):
    cameras = [turned_camera(camera_at((2.0, -3.0, 1.5), pixels=20), rotation_about(AXIS, angle)) for angle in ANGLES]
    turning = turning_with(cameras[0])
    lit = SampledLight.of(light, turning=turning)

    def mean(stage: Stage) -> torch.Tensor:
        radiance = rendered(stage, material, lit, bounces=1)
        return torch.stack([radiance[stage.seen.view() == view].mean(0) for view in range(stage.seen.shape[0])])

    alone = torch.cat([mean(Stage(mesh, [camera])) for camera in cameras])
    torch.testing.assert_close(mean(Stage(mesh, cameras)), alone, rtol=0.02, atol=0)


def test_there_is_no_control_variate_under_a_light_that_turns(mesh, light, material):
    camera = camera_at((2.0, -3.0, 1.5), pixels=20)
    stage, turning = Stage(mesh, [camera]), turning_with(camera)
    lit = SampledLight.of(light, turning=turning)
    plain, asked = (rendered(stage, material, lit, bounces=1, control_variate=one) for one in (False, True))
    assert torch.equal(plain, asked)


def test_gradients_are_those_of_the_picture(mesh, light, material):
    """In a direction of the light's space, which enters directly and by way of the object: against a difference."""
    cameras = [turned_camera(camera_at((2.0, -3.0, 1.5), pixels=12), rotation_about(AXIS, angle)) for angle in ANGLES]
    turning, stage = turning_with(cameras[0]), Stage(mesh, cameras)
    sampler = SampledLight.of(light).sampler
    change = torch.rand(light.shape, generator=torch.Generator().manual_seed(3))

    def loss(radiance: torch.Tensor, albedo: torch.Tensor) -> torch.Tensor:
        lit = SampledLight(radiance, sampler, turning)
        return rendered(stage, replace(material, albedo=albedo), lit, bounces=2).square().mean()

    leaves = light.clone().requires_grad_(True), material.albedo.clone().requires_grad_(True)
    loss(*leaves).backward()
    for leaf, moved in zip(leaves, (change, torch.rand(16, 16, 3, generator=torch.Generator().manual_seed(4))), strict=True):
        ends = [[each.detach() + (sign * 1e-2 * moved if each is leaf else 0) for each in leaves] for sign in (1, -1)]
        slope = (loss(*ends[0]) - loss(*ends[1])) / 2e-2
        torch.testing.assert_close((leaf.grad * moved).sum(), slope, rtol=2e-3, atol=0)


def test_few_turns_stand_for_all():
    turns = torch.from_numpy(np.stack([rotation_about(AXIS, angle) for angle in np.linspace(0, 2 * math.pi, 60, endpoint=False)]))
    chosen, nearest = spread_turns(turns, 16)
    between = torch.einsum("vij,vij->v", turns, turns[chosen][nearest])
    assert len(set(chosen.tolist())) == 16
    assert between.min() >= 1 + 2 * math.cos(math.radians(18.1))
    chosen, nearest = spread_turns(turns, None)
    assert chosen[nearest].tolist() == list(range(60))


# ---- the axis, from cameras ----
def ring(axis: np.ndarray, count: int, height: float, radius: float, middle: np.ndarray, noise: float) -> list[View]:
    rng = np.random.default_rng(count)
    to_axis = np.linalg.svd(axis[None])[2][[1, 2, 0]].T * [1, 1, np.sign(np.linalg.svd(axis[None])[2][0] @ axis)]
    to_axis[:, 0] *= np.linalg.det(to_axis)
    mask, image = np.zeros((8, 8), np.float32), np.zeros((8, 8, 3), np.float32)
    mask[2:6, 2:6] = 1
    views = []
    for angle in np.linspace(0, 2 * math.pi, count, endpoint=False):
        camera = camera_at((radius * math.cos(angle), radius * math.sin(angle), height), pixels=8)
        pose = camera.to_world.copy()
        pose[:3, :3], pose[:3, 3] = to_axis @ pose[:3, :3], to_axis @ pose[:3, 3] + middle + noise * rng.normal(size=3)
        views.append(View(f"{len(views)}", replace(camera, to_world=pose), image, mask))
    return views


@pytest.mark.parametrize("circles", [[(1.0, 3.0)], [(1.0, 3.0), (2.0, 2.2), (-0.5, 3.1)]])
def test_the_axis_is_found_from_cameras_on_circles(circles):
    middle = np.array([0.3, -0.2, 0.5])
    views = [
        view for place, (height, radius) in enumerate(circles) for view in ring(AXIS, 20 + place, height, radius, middle, 0.005)
    ]
    found, residual = fitted_circles(np.stack([view.camera.to_world for view in views]))
    assert len(found.circles) == len(circles)
    assert np.array(found.axis) @ AXIS > math.cos(math.radians(0.2))
    assert np.linalg.norm(np.cross(np.array(found.point) - middle, AXIS)) < 0.01
    assert 0.001 < residual < 0.01
    said: list[str] = []
    turning = turning_light(views, CaptureSettings(light="turntable"), said.append)
    angles = np.degrees(turning.angles(np.stack([view.camera.to_world for view in views[:20]])))
    assert np.abs((angles - 18 * np.arange(20) + 180) % 360 - 180).max() < 1
    assert "circle" in said[0]
    assert TurningLight.of_record(turning.record()) == turning


@pytest.mark.parametrize(("about", "angle"), [((0.6, 0.8, 0.0), 1.9), ((1.0, 0.0, 0.0), math.pi)])
def test_an_object_that_was_laid_down_anew_turns_about_another_axis_from_then_on(about, angle):
    """The object's pose Q in the room, by hand: the light of the room is at Q_0^T Q_v d of the map for direction d of view v."""
    room = camera_at((0.0, -3.0, 1.0), pixels=8)
    laid = rotation_about(np.array(about), angle)
    turns = np.linspace(0, 2 * math.pi, 20, endpoint=False)
    poses = [rotation_about(np.array([0, 0, 1.0]), angle) @ pose for pose in (np.eye(3), laid) for angle in turns]
    cameras = [turned_camera(room, pose.T) for pose in poses]
    nothing = np.zeros((8, 8), np.float32)
    views = [View(f"{number}", camera, np.zeros((8, 8, 3), np.float32), nothing) for number, camera in enumerate(cameras)]
    to_world = np.stack([camera.to_world for camera in cameras])
    rounds, residual = fitted_rounds(to_world)
    assert (len(rounds), residual < 1e-5) == (2, True)
    numbers = TurningLight((), rounds).rounds_of(to_world)
    assert numbers[0] != numbers[20]
    assert [len(set(numbers[some])) for some in (slice(20), slice(20, None))] == [1, 1]
    said: list[str] = []
    turning = turning_light(views, CaptureSettings(light="turntable"), said.append)
    assert "laid down anew" in said[1]
    np.testing.assert_allclose(turning.rotations(to_world), poses[0].T @ np.stack(poses), atol=1e-6)
    between = turned_camera(room, (rotation_about(np.array([0, 0, 1.0]), 0.4) @ laid).T)  # a photograph that was held out
    here = rotation_about(np.array([0, 0, 1.0]), 0.4) @ laid
    np.testing.assert_allclose(turning.rotations(between.to_world[None])[0], poses[0].T @ here, atol=1e-6)
    assert TurningLight.of_record(turning.record()) == turning


def test_cameras_on_the_axis_or_upside_down_are_refused():
    views = ring(AXIS, 20, 1.0, 3.0, np.zeros(3), 0.0)
    above = replace(views[0].camera, to_world=views[0].camera.to_world.copy())
    above.to_world[:3, 3] = 3 * AXIS
    top = [replace(views[0], name="top", camera=above)]
    with pytest.raises(InputError, match="expected cameras beside the axis, found top on it"):
        turning_light([*views, *20 * top], CaptureSettings(light="turntable"), lambda line: None)
    with np.errstate(all="raise"):  # a photograph that is held out may be
        assert np.isfinite(
            turning_light(views, CaptureSettings(light="turntable"), lambda line: None).rotations(above.to_world[None])
        ).all()
    down = views[3].camera.to_world.copy()
    down[:3, :2] *= -1  # rolled by a half turn
    rolled = [*views[:3], replace(views[3], camera=replace(views[3].camera, to_world=down)), *views[4:]]
    with pytest.raises(InputError, match="1 of them upside down"):
        turning_light(rolled, CaptureSettings(light="turntable"), lambda line: None)


def test_records_of_one_axis_are_still_read():
    former = {
        "start": np.eye(4)[:3].tolist(),
        "axis": [0.0, 0.0, 1.0],
        "point": [0.0, 0.0, 0.5],
        "residual": 0.01,
        "degrees": [0.0],
    }
    assert TurningLight.of_record(former).rounds == (Round((0.0, 0.0, 1.0), (0.0, 0.0, 0.5)),)
    assert TurningLight.of_record({**former, "axis": None}).rounds == ()


def test_other_cameras_are_refused_and_an_axis_may_be_given():
    rng = np.random.default_rng(0)
    views = [ring(AXIS, 20, *rng.uniform([-2, 1], [2, 3]), np.zeros(3), 0.0)[int(rng.integers(20))] for _ in range(30)]
    with pytest.raises(
        InputError, match=r"expected 5 cameras or more on circles around one axis, found 30, \d+\.\d % of their mean"
    ):
        turning_light(views, CaptureSettings(light="turntable"), lambda line: None)
    with pytest.raises(InputError, match=r"around one axis, found 6 cameras in 1 place\(s\)"):  # their poses in the room
        turning_light(views[:1] * 6, CaptureSettings(light="turntable"), lambda line: None)
    given = turning_light(views, CaptureSettings(light="turntable", turntable_axis=(0.0, 0.0, 2.0)), lambda line: None)
    assert given.rounds[0].axis == (0.0, 0.0, 1.0)
    with pytest.raises(InputError, match="expected a direction"):
        turning_light(views, CaptureSettings(light="turntable", turntable_axis=(0.0, 0.0, 0.0)), lambda line: None)


@pytest.mark.parametrize("how", ["given", "portrait", "far away"])
def test_half_a_turn_that_looks_past_the_axis_is_as_turned_as_it_is(how):
    """With the axis given; with a camera that was held upright, whose pixels are stored on their side; and far from the origin."""
    settings = CaptureSettings(light="turntable", turntable_axis=[0, 0, 1] if how == "given" else "auto")
    steps = np.linspace(0, math.pi, 12)
    views = []
    for number, angle in enumerate(steps):
        pose = camera_at((3.0, 0.0, 1.0), pixels=20).to_world.copy()
        pose[:3, 3] += 0.3 * pose[:3, 0]  # to the right of what it looks at
        if how == "portrait":
            pose[:3, :2] = np.stack([pose[:3, 1], -pose[:3, 0]], 1)
        pose[:3] = rotation_about(np.array([0.0, 0, 1]), angle) @ pose[:3]
        pose[2, 3] += 200.0 * (how == "far away")
        camera = replace(camera_at((3.0, 0.0, 1.0), pixels=20), to_world=pose)
        views.append(View(f"v{number}", camera, np.ones((20, 20, 3), np.float32), np.ones((20, 20), np.float32)))
    found = turning_light(views, settings, lambda line: None).rotations(np.stack([view.camera.to_world for view in views]))
    np.testing.assert_allclose(found, Rotation.from_rotvec(-steps[:, None] * [0, 0, 1]).as_matrix(), atol=1e-4)
