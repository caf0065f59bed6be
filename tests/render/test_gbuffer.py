"""What pixels see: against Cycles' alpha, depth and normal of `tiny`, and on meshes whose answer is known."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from shapes import camera_at, mesh_of, plate, soup, sphere, together
from stage import CPU

from benchmarks import reference
from ia_bench.render.gbuffer import GBuffer, SurfaceInterpolator, pixels_in_reach, primary_rays, sees, trace_gbuffer
from ia_bench.render.rays import make_rays
from ia_bench.scenes.scene import Scene

FINE = 8  # sub-samples along a side where Cycles has thousands


@pytest.fixture(scope="module")
def fine(tiny: Scene) -> tuple[SurfaceInterpolator, GBuffer]:
    surface = SurfaceInterpolator(tiny.mesh, CPU)
    return surface, trace_gbuffer([view.camera for view in tiny.test], make_rays(tiny.mesh, CPU), FINE, CPU)


def test_coverage_is_the_alpha_of_cycles(tiny: Scene, fine: tuple[SurfaceInterpolator, GBuffer]) -> None:
    ours, alpha = fine[1].coverage().numpy(), np.stack([view.mask for view in tiny.test])
    for a, b in zip(ours, alpha, strict=True):
        assert np.minimum(a, b).sum() / np.maximum(a, b).sum() > 0.99
    assert np.abs(ours - alpha).max() < 0.1  # 64 stratified points miss a sliver of a pixel


def test_depth_and_normal_are_those_of_cycles(tiny: Scene, fine: tuple[SurfaceInterpolator, GBuffer]) -> None:
    """Inside the object: depth to 0.5 % (half of the pixels: 0.1 %), normals to 0.06 (half: 0.003), in 99 % of pixels.

    Both are means over a pixel; what differs is 64 points here against thousands there, at edges inside a pixel. Normals are
    shipped in steps of 1/256, which alone is an error of 0.002.
    """
    surface, gbuffer = fine
    pixels, points = gbuffer.face.shape
    hit = (gbuffer.face >= 0).reshape(-1)
    view = (gbuffer.pixel // 1024)[:, None].expand(-1, points).reshape(-1)
    found = surface(gbuffer.face.clamp_min(0).reshape(-1).long(), gbuffer.barycentric.reshape(-1, 2), gbuffer.origin[view])
    forward = torch.stack([torch.from_numpy(-v.camera.to_world[:3, 2]).float() for v in tiny.test])[view]
    depth = ((found.position - gbuffer.origin[view]) * forward).sum(-1)

    def image(values: torch.Tensor) -> np.ndarray:
        """Premultiplied pixel means (4, 32, 32, C)."""
        flat = torch.zeros(4 * 1024, values.shape[-1])
        flat[gbuffer.pixel] = (values * hit[:, None]).reshape(pixels, points, -1).mean(1)
        return flat.reshape(4, 32, 32, -1).numpy()

    inside = np.stack([v.mask for v in tiny.test]) > 0.999
    assert inside.sum() > 1000
    true_depth = np.stack([v.depth for v in tiny.test])[inside]
    error = np.abs(image(depth[:, None])[..., 0][inside] - true_depth) / true_depth
    assert np.median(error) < 1e-3
    assert np.quantile(error, 0.99) < 5e-3
    error = np.linalg.norm(image(found.normal)[inside] - np.stack([v.normal for v in tiny.test])[inside], axis=-1)
    assert np.median(error) < 3e-3
    assert np.quantile(error, 0.99) < 0.06


@pytest.mark.parametrize("side", [1, 2, 3])
def test_coverage_of_a_plate_is_its_share_of_the_picture(side: int) -> None:
    """From above, at distance 5 with 40 degrees, a plate covers a square in the middle."""
    camera = camera_at((0, 0, 5), pixels=12)
    mesh = plate(5 * np.tan(np.radians(20)) * 7 / 12)  # 7 of 12 pixels across: borders in the middle of a pixel
    gbuffer = trace_gbuffer([camera, camera], make_rays(mesh, CPU), side, CPU)
    assert gbuffer.subsamples == side * side
    assert gbuffer.shape == (2, 12, 12)
    coverage = gbuffer.coverage()
    assert torch.equal(coverage[0], coverage[1])
    assert (coverage[0, 3:9, 3:9] == 1).all()
    assert (coverage[0, :2] == 0).all()
    if side == 2:
        assert (coverage[0, 2, 3:9] == 0.5).all()
        assert float(coverage[0].sum()) == 49


@pytest.mark.parametrize(
    ("place", "shift", "fewer"),
    [
        ((2, 3, 1), (0.0, 0.0), True),
        ((2, 3, 1), (9.5, -4.25), True),  # partly out of the picture
        ((0.2, 0.1, 0.3), (0.0, 0.0), False),  # from inside: triangles before, beside and behind the camera
    ],
)
def test_pixels_that_no_triangle_can_reach_see_nothing(place: tuple, shift: tuple[float, float], fewer: bool) -> None:
    looking = camera_at(place, pixels=31)
    camera = replace(looking, centre=(looking.centre[0] + shift[0], looking.centre[1] + shift[1]))
    mesh, everywhere = sphere(2), np.arange(31 * 31)
    reached = pixels_in_reach(camera, mesh)
    assert (len(reached) < 0.7 * len(everywhere)) == fewer
    whole, part = (torch.from_numpy(a).reshape(-1, 3) for a in primary_rays(camera, 3)), primary_rays(camera, 3, reached)
    face = make_rays(mesh, CPU).intersect(*whole)[0].reshape(-1, 9)
    gbuffer = trace_gbuffer([camera], make_rays(mesh, CPU), 3, CPU)
    assert torch.equal(gbuffer.pixel, torch.nonzero((face >= 0).any(1))[:, 0])
    assert torch.equal(gbuffer.face.long(), face[gbuffer.pixel])
    np.testing.assert_array_equal(part[1], primary_rays(camera, 3)[1].reshape(-1, 9, 3)[reached])


def test_shading_normals_that_face_away_are_bent_to_grazing_and_counted() -> None:
    normals = np.tile([0.8, 0.0, 0.6], (3, 1))
    mesh = mesh_of([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)], normals=normals)
    surface = SurfaceInterpolator(mesh, CPU)
    face, middle = torch.tensor([0, 0]), torch.tensor([[0.3, 0.3], [0.3, 0.3]])
    points = surface(face, middle, torch.tensor([[-5.0, 0.3, 0.5], [0.3, 0.3, 5.0]]))
    assert (surface.bent_normals, surface.points) == (1, 2)
    cosine = (points.normal * points.view).sum(-1)
    assert 0 < float(cosine[0]) < 0.01
    torch.testing.assert_close(points.normal.norm(dim=-1), torch.ones(2))
    torch.testing.assert_close(points.normal[1], torch.tensor([0.8, 0.0, 0.6]))


@pytest.mark.parametrize("size", [1.0, 1e-5, 1e-12, 1e6])
def test_triangles_have_unit_normals_in_any_units(size: float) -> None:
    corners = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 1), (2, 0, 0), (2, 0.01, 0), (2, 0, 0.01)])
    surface = SurfaceInterpolator(mesh_of((size * corners).tolist(), [(0, 1, 2), (3, 4, 5)]), CPU)
    torch.testing.assert_close(surface.geometric, torch.tensor([[0.0, -(0.5**0.5), 0.5**0.5], [1.0, 0.0, 0.0]]))


def test_points_are_those_of_torch() -> None:
    """In float64: a mesh of triangles in any direction with smooth normals of their own, seen from all around, some misses."""
    rng = torch.Generator().manual_seed(0)
    mesh = soup(60, 3)
    normals = torch.nn.functional.normalize(torch.randn(len(mesh.vertices), 3, generator=rng), dim=-1).numpy()
    mesh = replace(mesh, normals=normals, uv=np.random.default_rng(0).random((len(mesh.vertices), 2)).astype(np.float32))
    count = 20_000
    face = torch.randint(-1, len(mesh.faces), (count,), generator=rng)
    corner = torch.rand(count, 2, generator=rng)
    barycentric = torch.where(corner.sum(-1, keepdim=True) > 1, 1 - corner, corner)
    camera = 5 * torch.nn.functional.normalize(torch.randn(count, 3, generator=rng), dim=-1)
    surface = SurfaceInterpolator(mesh, CPU)
    found = surface(face, barycentric, camera)
    wanted, bent = reference.interpolate(mesh, face, barycentric.double(), camera.double())
    cosine = (wanted.geometric * wanted.view).sum(-1)
    clear = cosine.abs() > 1e-4  # which side is seen, and whether a normal faces away, is clear
    assert clear.float().mean() > 0.99
    assert torch.equal(found.front[clear], wanted.front[clear])
    assert 0.3 < float(found.front.float().mean()) < 0.7
    assert (surface.points, surface.bent_normals) == (int((face >= 0).sum()), int(bent.sum()))
    assert surface.bent_normals > 1000
    for name in ("position", "uv", "view", "geometric", "normal"):
        ours, theirs = (getattr(points, name)[clear] for points in (found, wanted))
        torch.testing.assert_close(ours.double(), theirs, rtol=0, atol=2e-5 if name == "normal" else 2e-6)


@pytest.fixture(params=[0, 1, 40])
def scattered(request: pytest.FixtureRequest) -> tuple[GBuffer, list[tuple[int, int, int]]]:
    """So many pixels of 3 views of 5 x 7 in any order, and the (view, row, column) of each."""
    rng = torch.Generator().manual_seed(0)
    everywhere = [(view, row, column) for view in range(3) for row in range(5) for column in range(7)]
    pixel = torch.randperm(len(everywhere), generator=rng)[: request.param]
    face, barycentric = torch.randint(-1, 9, (len(pixel), 4), generator=rng).int(), torch.rand(len(pixel), 4, 2, generator=rng)
    gbuffer = GBuffer(face, barycentric, pixel, torch.rand(3, 4, 4, generator=rng), (3, 5, 7))
    return gbuffer, [everywhere[flat] for flat in pixel.tolist()]


def test_entries_are_found_in_views_and_images_as_by_a_loop(scattered: tuple[GBuffer, list[tuple[int, int, int]]]) -> None:
    """Views and cameras of entries, the entry of a pixel, values of any type as images, and the share of hits."""
    gbuffer, places = scattered
    some, every_other = torch.arange(len(places))[::3].flip(0).repeat(2), torch.arange(len(places)) % 2 == 0
    for entries, chosen in ((None, places), (some, [places[i] for i in some]), (every_other, places[::2])):
        assert gbuffer.view(entries).tolist() == [place[0] for place in chosen]
        assert torch.equal(gbuffer.seen_from(entries), gbuffer.origin[[place[0] for place in chosen]])
    entry = gbuffer.entry_of_pixel().reshape(3, 5, 7)
    coverage = np.zeros((3, 5, 7), np.float32)
    for place in np.ndindex(3, 5, 7):
        assert int(entry[place]) == (places.index(place) if place in places else -1)
    for place, face in zip(places, gbuffer.face.tolist(), strict=True):
        coverage[place] = sum(one >= 0 for one in face) / 4
    np.testing.assert_array_equal(gbuffer.coverage().numpy(), coverage)
    for channels, dtype in (((), torch.bool), ((3,), torch.float64), ((2, 2), torch.int32)):
        values = (9 * torch.rand(len(places), *channels, generator=torch.Generator().manual_seed(1))).to(dtype)
        expected = np.zeros((3, 5, 7, *channels), values.numpy().dtype)
        for place, value in zip(places, values.numpy(), strict=True):
            expected[place] = value
        assert gbuffer.images(values).dtype == dtype
        np.testing.assert_array_equal(gbuffer.images(values).numpy(), expected)


def test_a_camera_sees_what_nothing_between_hides() -> None:
    """Of a floor under a lid: one between both, one above the lid, one that looks along the floor, one too near for its frame."""
    rays = make_rays(together(plate(1.0), plate(1.0, height=2.0)), CPU)
    cameras = [camera_at((0.0, 0.0, height)) for height in (1.0, 3.0)] + [camera_at((9.0, 0.0, 1.0)), camera_at((0.0, 0.0, 0.1))]
    positions, normals = torch.tensor([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0]]), torch.tensor([[0.0, 0.0, 1.0]]).expand(2, 3)
    found = sees(cameras, positions, normals, rays, 1e-4)
    assert found.tolist() == [[True, False, False, True], [True, False, False, False]]
