"""NeILF++: its networks, its sums over directions and its trace loss against independent answers, and as a method."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
import torch
from torch import Tensor

from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.render.stage import Stage
from ia_bench.scenes.scene import Mesh, Scene
from ia_bench_baselines.common.networks import positional_encoding
from ia_bench_baselines.neilfpp.fields import FREQUENCIES, HashGrid, IncidentField
from ia_bench_baselines.neilfpp.losses import OUTGOING_SHARE, scharr_edges, second_hits, trace_loss
from ia_bench_baselines.neilfpp.method import Neilfpp, NeilfppOptions
from ia_bench_baselines.neilfpp.shading import quadrature, reflect, sphere_directions
from tests.baselines.home_ground import check_recovered, problem_of, smooth_material
from tests.baselines.reflecting import COLOUR, NORMAL, VIEW, Reflecting, directions, points_at, some_directions


def brute_force(normal: Tensor, view: Tensor, incident: Tensor, colour: Tensor, roughness: float, metallic: float) -> Tensor:
    """BRDF times cosine (D, 3) for directions (D, 3), written down anew in float64."""
    half = torch.nn.functional.normalize(incident + view, dim=-1)
    cos_i, cos_o, cos_h, cos_d = incident @ normal, float(view @ normal), half @ normal, half @ view
    at_normal = 0.04 * (1 - metallic) + metallic * colour
    fresnel = at_normal + (1 - at_normal) * ((1 - cos_d) ** 5)[:, None]
    distribution = torch.exp(2 / roughness**4 * (cos_h - 1)) / (math.pi * roughness**4)
    masked = [0.5 / (c * (1 - roughness**2 / 2) + roughness**2 / 2) for c in (cos_i, torch.as_tensor(cos_o))]
    specular = fresnel * (distribution * masked[0] * masked[1])[:, None]
    value = ((1 - metallic) * colour / math.pi + specular) * cos_i[:, None]
    return torch.where(cos_i[:, None] > 0, value, torch.zeros_like(value))


@pytest.mark.parametrize(("roughness", "metallic"), [(0.15, 0.0), (0.4, 0.7), (1.0, 0.2)])
def test_one_direction_is_the_brdf_in_float64(roughness: float, metallic: float):
    material, incident = (COLOUR[None], torch.tensor([[roughness]]), torch.tensor([[metallic]])), some_directions()
    point, one = points_at(NORMAL[None], VIEW[None]), torch.ones(1, 1)
    found = torch.cat([reflect(point, material, way[None, None], one, torch.ones(1, 1, 3)) for way in incident])
    true = brute_force(NORMAL.double(), VIEW.double(), incident.double(), COLOUR.double(), roughness, metallic)
    torch.testing.assert_close(found.double(), true, rtol=5e-3, atol=1e-5)


@pytest.mark.parametrize("roughness", [0.3, 0.8])
def test_many_directions_are_the_integral(roughness: float):
    """Against a quadrature over a lat-long grid, under light that differs by channel and direction."""

    def light(along: Tensor) -> Tensor:
        return 1 + along + torch.exp(5 * (along @ along.new_tensor([0.0, 0.8, 0.6]) - 1))[:, None]

    grid, area = directions()
    value = brute_force(NORMAL.double(), VIEW.double(), grid, COLOUR.double(), roughness, 0.3)
    true = (value * light(grid) * area[:, None]).sum(0)
    material = COLOUR[None], torch.tensor([[roughness]]), torch.tensor([[0.3]])
    point = points_at(NORMAL[None], VIEW[None])
    around = quadrature(point, material[1], 2**14, 2**12, torch.Generator().manual_seed(0))
    every = around.of_points()
    found = reflect(point, material, every, around.weight, light(every[0])[None])
    torch.testing.assert_close(found[0].double(), true, rtol=5e-3, atol=0)


def test_a_field_in_parts_is_the_network_of_both_inputs():
    """Layers of the direction alone, then of both: written down for every pair."""
    generator = torch.Generator().manual_seed(0)
    field = IncidentField(width=8, start=0.3, generator=generator)
    directions, positions = torch.randn(5, 3, generator=generator), torch.randn(7, 3, generator=generator)
    found = field.finish((field.middle(directions)[:, None] + field.inserted(positions)).reshape(-1, 8))
    hidden = positional_encoding(directions.repeat_interleave(7, 0), FREQUENCIES)
    hidden = torch.relu(field.front[2](torch.relu(field.front[0](hidden))))
    both = torch.cat([hidden, positions.repeat(5, 1)], 1)
    hidden = torch.relu(both @ torch.cat([field.along.weight, field.at.weight], 1).T + field.along.bias)
    torch.testing.assert_close(found, field.back[2](torch.relu(field.back[0](hidden))), rtol=1e-4, atol=1e-5)


def test_a_level_of_a_hash_grid_is_linear_between_its_entries():
    """At corners of cells it is the entry that the hash names, and in a cell's middle the mean of the eight around it."""
    grid = HashGrid(levels=1, features=2, log_size=8, coarsest=4, finest=4, generator=torch.Generator().manual_seed(0))

    def entry(corner: Sequence[int]) -> Tensor:
        x, y, z = corner
        return grid.table[(x ^ (y * 2654435761) ^ (z * 805459861)) % 256]

    torch.testing.assert_close(grid(torch.tensor([[0.0, -0.5, 0.5]]))[0], entry((2, 1, 3)))
    around = [entry((2 + a, 1 + b, 3 + c)) for a in (0, 1) for b in (0, 1) for c in (0, 1)]
    torch.testing.assert_close(grid(torch.tensor([[0.25, -0.25, 0.75]]))[0], torch.stack(around).mean(0))


# ---- edges of images ---------------------------------------------------------------------------------------------------
def test_a_step_in_an_image_is_an_edge_of_sixteen_times_its_height():
    """As cv2.Sobel has it with FILTER_SCHARR: 3 + 10 + 3. By exp(-edge) a step of .25 leaves 2 per cent of the smoothness."""
    image = torch.zeros(5, 6, 3)
    image[:, 3:] = 0.25
    wanted = torch.tensor([0.0, 0, 4, 4, 0, 0]).expand(5, 6)
    torch.testing.assert_close(scharr_edges(image[None])[0], wanted)
    torch.testing.assert_close(scharr_edges(image.transpose(0, 1)[None])[0], wanted.T)


# ---- the trace loss ----------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def facing() -> Stage:
    """Two squares [-1, 1]^2 that face each other, at z = 0 and z = 1."""
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float32)
    vertices = np.concatenate([np.c_[square, np.zeros(4)], np.c_[square, np.ones(4)]]).astype(np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]], np.int32)
    normals = np.repeat(np.array([[0, 0, 1], [0, 0, -1]], np.float32), 4, 0)
    return Stage(Mesh(vertices, faces, normals, np.concatenate([square, square]) / 4 + 0.5), torch.device("cpu"))


class Planes:
    """A surface light field that is known: a linear function of position and direction."""

    def __init__(self) -> None:
        self.gain = torch.ones((), requires_grad=True)

    def local(self, position: Tensor) -> Tensor:
        return position / 2

    def outgoing(self, local: Tensor, directions: Tensor) -> Tensor:
        return self.gain * (2 + local[:, :1] + 10 * directions[:, 2:]).expand(-1, 3)


def test_the_trace_loss_is_the_distance_to_what_the_other_plane_sends(facing: Stage):
    """What arrives at the lower plane from (x, y) of the upper one was sent down: 2 + x / 2 - 10 w_z."""
    directions = torch.nn.functional.normalize(torch.tensor([[0.5, 0.0, 1.0], [0.0, 0.0, 1.0], [-0.3, 0.4, 1.0]]), dim=1)
    up = torch.tensor([0.0, 0, 1]).expand(3, 3)
    hit, position = second_hits(facing, torch.zeros(3, 3), up, directions)
    sent = 2 + torch.tensor([0.5, 0.0, -0.3]) / 2 - 10 * directions[:, 2]
    incident = (sent + torch.tensor([0.1, -0.2, 0.3]))[:, None].expand(3, 3).clone().requires_grad_()
    planes = Planes()
    loss = trace_loss(planes, incident, position, directions[hit], held=False)  # type: ignore[arg-type]
    assert float(loss.detach()) == pytest.approx(0.2, abs=1e-3)
    loss.backward()
    signs = torch.tensor([1.0, -1.0, 1.0])
    assert float(planes.gain.grad) == pytest.approx(-OUTGOING_SHARE * float((signs * sent).mean()), rel=1e-3)
    torch.testing.assert_close(incident.grad, signs[:, None].expand(3, 3) / 9)
    held = Planes()
    trace_loss(held, incident, position, directions[hit], held=True).backward()  # type: ignore[arg-type]
    assert held.gain.grad is None


# ---- the method --------------------------------------------------------------------------------------------------------
@pytest.mark.slow
def test_on_its_home_ground_it_recovers_the_material(tiny: Scene):
    """Photographs by its own sums over directions, of incident light that other parts of the object send or hide."""

    def shade(points: SurfacePoints, values: Tensor, directions: Tensor, light: Tensor) -> Tensor:
        colour, roughness, metallic = values.split((3, 1, 1), 1)
        every = directions.expand(len(light), -1, -1)
        weight = torch.full(every.shape[:2], 4 * math.pi / len(directions))
        return reflect(points, (colour, roughness, metallic), every, weight, light)

    material = smooth_material(metallic=True)
    truth = Reflecting(problem_of(tiny).stage, material, shade, lambda generator: sphere_directions(512, generator))
    check_recovered(Neilfpp(NeilfppOptions()), truth, tiny, albedo=18, roughness=0.055)  # the aims are 30 and .01: see the card
