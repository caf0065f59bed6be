"""What the plan decides, from made-up scenes whose answer is known."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from shapes import bowl, camera_at, disk, plate, sphere, together
from small_fit import RENDER, plan_of, scene_of

from ia_bench.common.errors import InputError
from ia_bench.methods.contract import Problem
from ia_bench.methods.plan import LIGHT_HEIGHTS, TEXTURE_SIZES, VIEWS_A_POINT, Decision, _normal_errors, _Probe, choose_prior_views
from ia_bench.render.stage import Stage
from ia_bench.scenes.scene import Camera, Mesh, Scene

CPU = torch.device("cpu")
FROM_ABOVE = camera_at((0, 0, 5), pixels=32)
VIEW_WIDTH = 2 * 5 * math.tan(math.radians(20))  # of FROM_ABOVE, at the origin
FILLING = VIEW_WIDTH / 2 * 1.05  # half a side of a plate that fills FROM_ABOVE


def decided(name: str, mesh: Mesh, *cameras: Camera) -> Decision:
    """What the plan says of one of the renderer's settings."""
    (found,) = [d for d in plan_of(mesh, *cameras).decisions if d.what == f"render.{name}"]
    return found


# ---------------------------------------------------------------- shadows, indirect light
@pytest.mark.parametrize("smooth", [True, False])
def test_a_convex_sphere_needs_no_shadow_rays(smooth: bool) -> None:
    found = decided("shadows", sphere(3, smooth=smooth), camera_at((3, 2, 1)), camera_at((-3, 2, 1)))
    assert (found.value, found.measured["occluded_share"], found.left_out) == ("none", 0, "shadow rays")


def test_a_plate_under_a_disk_needs_them() -> None:
    """The disk hides R^2 / (R^2 + h^2) of the cosine-weighted sky of a small plate; the camera sees only the plate."""
    radius, height = 0.7, 0.6
    camera = camera_at((0.3, 0.0, 0.05), pixels=16, field_of_view=1.0)
    found = decided("shadows", together(plate(0.01), disk(radius, height=height)), camera)
    assert (found.value, found.left_out) == ("traced", None)
    share = radius**2 / (radius**2 + height**2)
    assert found.measured["occluded_share"] == pytest.approx(share, abs=5 * math.sqrt(0.25 / found.measured["probe_rays"]))


def test_bounces() -> None:
    """None on a ball. Half of the rays from the inside of a hemisphere meet it again, each time: with albedo 1/2 the share is 1/4.

    Of 20 000 paths the share's standard error is 0.3 %; below 0.5 % are left after three bounces (1/4^4 = 0.4 %).
    """
    found = decided("bounces", sphere(3), camera_at((3.0, 1.0, 1.0)))
    assert (found.value, found.left_out) == (0, "indirect light")
    assert found.measured["indirect_share"] < 0.001
    found = decided("bounces", bowl(), camera_at((0.0, 0.0, 4.0)))
    assert (found.value, found.left_out) == (3, "more than 3 bounces")
    assert found.measured["indirect_share"] == pytest.approx(0.25, abs=0.012)
    assert found.measured["share_beyond_one"] == pytest.approx(1 / 16, abs=0.008)


# ---------------------------------------------------------------- sub-samples
def test_points_of_a_pixel() -> None:
    """One on a flat plate that fills the view; more at edges, of thin parts, and where the surface bends within a pixel."""
    found = decided("subsamples", plate(FILLING), FROM_ABOVE)
    assert (found.value, found.left_out) == (1, "pixel sub-samples")
    assert found.measured == {"edge_pixel_share": 0, "mean_normal_change_degrees": 0, "normal_error_of_2_x_2": 0}
    # A flat plate of 7 by 7 pixels plus half a pixel all around: 32 of its 81 pixels are partly covered.
    found = decided("subsamples", plate(VIEW_WIDTH / 2 * 8 / 32), camera_at((0, 0, 5), pixels=31))
    assert found.value == 3
    assert found.measured["edge_pixel_share"] > 0.2
    assert found.measured["mean_normal_change_degrees"] == 0
    # Plates of two thirds of a pixel, a pixel apart: every pixel is an edge. Coarse edges take no more than 2 x 2.
    pixel = VIEW_WIDTH / 32
    thin = plate(pixel / 3)
    strips = [replace(thin, vertices=thin.vertices + np.array([2 * x * pixel, 0, 0], np.float32)) for x in range(-4, 5)]
    assert decided("subsamples", together(*strips), FROM_ABOVE).value >= 3
    assert decided("subsamples", plate(FILLING / 2), camera_at((0, 0, 5), pixels=128)).value == 2
    # A sphere that fills the view: no edges, but a pixel spans 2.6 degrees of it in the middle, more outside.
    found = decided("subsamples", sphere(4), camera_at((0, 2, 0), pixels=16))
    assert (found.value, found.measured["edge_pixel_share"]) == (2, 0)
    smallest = math.degrees(1 * 2 * math.tan(math.radians(20)) / 16)
    assert smallest < found.measured["mean_normal_change_degrees"] < 3 * smallest


def test_the_expected_error_of_a_mean_normal_is_the_one_against_many_points(tiny: Scene) -> None:
    """Within a factor of 1.5 of that against 8 x 8 points, for 1 to 4 points a side of the shipped scene `tiny`."""
    stage = Stage(tiny.mesh, CPU)
    cameras = [view.camera for view in tiny.train[::4]]

    def mean_normals(side: int) -> torch.Tensor:
        gbuffer = stage.gbuffer(cameras, side)
        hit = gbuffer.face >= 0
        camera = gbuffer.origin[gbuffer.pixel // (32 * 32)][:, None].expand(*hit.shape, 3)
        normal = torch.zeros(*hit.shape, 3)
        normal[hit] = stage.surface(gbuffer.face[hit].long(), gbuffer.barycentric[hit], camera[hit]).normal
        image = torch.zeros(len(cameras) * 32 * 32, 3)
        image[gbuffer.pixel] = normal.mean(1)
        return image

    many, two = mean_normals(8), stage.gbuffer(cameras, 2)
    for side in (1, 2, 3, 4):
        true = float((mean_normals(side) - many)[two.pixel].square().sum(-1).mean().sqrt())
        assert true / 1.5 < _normal_errors(_Probe(tiny, stage, two))[side] < 1.5 * true


# ---------------------------------------------------------------- texture and light
@pytest.mark.parametrize(
    ("uv_scale", "pixels", "size"),
    [(1.0, 32, 64), (0.25, 32, 256), (0.1, 32, 512), (1.0, 200, 256), (1e-3, 32, 2048), (1.0, 8, 64)],
)
def test_texture_follows_the_footprint_of_a_pixel(uv_scale: float, pixels: int, size: int) -> None:
    """A plate's pixel spans uv_scale / pixels of the texture (a little less: it fills more than the view)."""
    found = decided("texture", plate(FILLING, uv_scale=uv_scale), camera_at((0, 0, 5), pixels=pixels))
    assert found.measured["pixel_footprint_uv"] == pytest.approx(uv_scale / 1.05 / pixels, rel=1e-3)
    assert (found.value, found.left_out) == (size, f"textures above {size} texels" if size < TEXTURE_SIZES[-1] else None)


def test_jumps_to_another_island_are_no_footprint() -> None:
    """Two plates side by side on opposite corners of the atlas: their common border does not count."""
    left, right = plate(FILLING / 2, uv_scale=0.1), plate(FILLING / 2, uv_scale=0.1)
    shift = np.array([FILLING / 2, 0, 0], np.float32)
    left = replace(left, vertices=left.vertices - shift)
    right = replace(right, vertices=right.vertices + shift, uv=right.uv + 0.9)
    one, both = (decided("texture", mesh, FROM_ABOVE) for mesh in (left, together(left, right)))
    assert both.measured["pixel_footprint_uv"] == pytest.approx(one.measured["pixel_footprint_uv"], rel=1e-3)
    assert both.value == one.value == 256


def test_light() -> None:
    """On a plate, mirror directions turn by as much as view directions do, 40 degrees over 32 pixels: 150 rows would be seen.

    A ball that is 10 pixels wide reflects half of the sphere in a few pixels: the coarsest light will do.
    """
    found = decided("light_height", plate(FILLING), FROM_ABOVE)
    middle = math.degrees(VIEW_WIDTH / 32 / 5)  # 1.30 degrees in the middle, less toward the corners
    assert 0.8 * middle < found.measured["mirror_footprint_degrees"] < middle
    assert (found.value, found.left_out) == (LIGHT_HEIGHTS[-1], f"light rows above {LIGHT_HEIGHTS[-1]}")
    assert "worse with finer lights" in found.why
    assert decided("light_height", sphere(3), camera_at((0, 18, 0), pixels=32)).value == LIGHT_HEIGHTS[0]


# ---------------------------------------------------------------- the whole
USERS = {"shadows": "traced", "bounces": 1, "subsamples": 3, "texture": 96, "light_height": 48}


@pytest.mark.parametrize("name", USERS)
def test_a_users_setting_is_taken_and_recorded_as_such(name: str) -> None:
    """Whatever the measurement would have said; the other decisions stay what they were."""
    usual = plan_of(plate(FILLING), FROM_ABOVE)
    plan = plan_of(plate(FILLING), FROM_ABOVE, **{name: USERS[name]})
    assert getattr(plan, name) == USERS[name] != getattr(usual, name)
    (found,) = [d for d in plan.decisions if d.what == f"render.{name}"]
    assert (found.value, found.why, found.measured, found.left_out) == (USERS[name], "as it was set", None, None)
    others = [d for d in plan.decisions if d.what != found.what]
    assert others == [d for d in usual.decisions if d.what != found.what]


def test_cameras_that_do_not_see_the_mesh_are_named() -> None:
    """The usual cause is a matrix of another convention: the camera looks the other way."""
    camera = camera_at((0, 0, 5))
    turned = camera.to_world @ np.diag([1.0, -1.0, -1.0, 1.0])  # OpenCV: looks along +z
    with pytest.raises(InputError, match=r"made-up.*no training camera sees the mesh.*transform_matrix.*-z"):
        plan_of(sphere(2), replace(camera, to_world=turned))


def around(count: int) -> list[Camera]:
    """Cameras on a circle in the plane z = 1."""
    return [camera_at((4 * math.cos(a), 4 * math.sin(a), 1.0)) for a in np.arange(count) * 2 * np.pi / count]


def views_chosen(count: int, setting: int | str) -> Decision:
    mesh = sphere(3)
    return choose_prior_views(scene_of(mesh, *around(count)), Stage(mesh, CPU), setting)


def test_a_prior_is_asked_about_as_many_views_as_show_the_surface() -> None:
    """Sixty views around a ball show it far more often than is wanted; with four, each is needed."""
    many, few = (views_chosen(count, "auto") for count in (60, 4))
    assert 8 <= many.value < 60
    assert many.measured["seen_by_chosen_views"] >= 0.9 * VIEWS_A_POINT
    assert many.left_out == f"the prior's look at {60 - many.value} views"
    assert (few.value, few.left_out) == (4, None)
    assert [views_chosen(12, setting).value for setting in ("all", 5)] == ["all", 5]


@pytest.mark.parametrize(
    ("name", "value"), [("texture", 100_000), ("light_height", 1_000_000), ("samples", 10**12), ("subsamples", 2000)]
)
def test_what_the_machine_cannot_hold_is_told_before_it_is_allocated(name: str, value: int) -> None:
    with pytest.raises(InputError, match=rf"render\.(samples|{name})=.*: expected to fit into the .* GB of memory that are free"):
        plan_of(plate(FILLING), FROM_ABOVE, **{name: value})


@pytest.mark.parametrize(("bounces", "controlled"), [(0, False), (1, True)])
def test_there_is_a_control_variate_where_there_is_indirect_light(tiny: Scene, bounces: int, controlled: bool) -> None:
    interreflection = Problem(tiny.blind(), replace(RENDER, bounces=bounces)).renderer.interreflection
    assert (interreflection is not None and interreflection.control is not None) is controlled
