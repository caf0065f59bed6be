"""A surface from photographs and masks: the hull, hollowed by stereo, refined until its pictures are the photographs.

1. The visual hull bounds the object. 2. Depth maps by plane sweeping find its hollows, however deep, as steps along a gradient
would not, and are fused into one field (:mod:`~ia_bench.geometry.sweep`). 3. The distances at
the vertices of a grid, features beside them and a small network are fitted to all pixels by volume rendering
(:mod:`~ia_bench.geometry.marching`), at one size from the first step on, since coarse cells close hollows again. Minimised is,
over random pixels,

    |t(c) - t(c')| + MASK |A - mask| + EIKONAL (|grad f| - 1)^2 + SMOOTH (laplacian f)^2,      t(c) = log(1 + 3 c / mean)

with c the colour that rays gather and A their opacity; the last two over the vertices near the surface, in cells. Nothing
is known of the light, so shading is seen as paint, which tells shape as well where views overlap. Where the light turns with the
camera, shading belongs to the normal as the light sees it; since stereo may be misled there, what it found and the hull are both
tried as the start.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate, normalize, softplus

from ia_bench.common.errors import InputError
from ia_bench.common.progress import Begin, ProgressBar, unseen
from ia_bench.geometry.consistency import MovingPhotographs
from ia_bench.geometry.grid import DistanceGrid, sampled
from ia_bench.geometry.hull import visual_hull
from ia_bench.geometry.marching import Pixels, gathered, pixels_of
from ia_bench.geometry.sweep import depth_maps, fused
from ia_bench.geometry.warp_march import CHANNELS
from ia_bench.scenes.scene import View

LEAST_VIEWS = 4  # fewer leave a hull in which no surface can be told
WIDTH, STRIDE = 0.55, 0.4  # cells: of the soft surface, and of the rays' segments
BATCH, RUN = 12288, 8  # rays a step, in runs of neighbouring pixels, which read the same cells
LEVELS = 5  # grids, each of twice the cells of the next, whose sum moves the distances: large shapes move as fast as small ones
DISTANCE_RATE, FEATURE_RATE, NETWORK_RATE, GAIN_RATE, OFFSET_RATE = 0.05, 0.1, 5e-3, 5e-3, 0.02  # of Adam, in the beginning ...
FALL = 0.1  # ... and times that in the end
WARM = 0.15  # of the steps in which the surface stays: before it has colours, all of them seem to be wrong
MASK, EIKONAL, SMOOTH = 0.5, 0.05, 0.02  # weights of the loss
OFFSET = 1e-3  # and of the square of a pixel by which a photograph moves
BAND = 3.0  # cells from the surface within which vertices are regular
BEYOND = 0.5  # cells that the surface may leave the hull by, where masks are not quite right
AGAIN = 20  # steps after which the vertices near the surface are looked for again
TRIAL = 4  # of two starts, that is taken which is better after so many-th of the steps
HIDDEN = 32  # units of the layers of the network of colours
BEGINNING = -3.0  # what its last layer starts with: softplus of it is .05 of the mean colour
DARK = -0.5  # first value of the features of the colour: softplus of it is half of the mean radiance


def surface_from_images(
    views: Sequence[View],
    cells: int,
    steps: int,
    *,
    tolerated: int = 0,
    exposures_differ: bool = False,
    photographs: MovingPhotographs | None = None,
    turns: np.ndarray | None = None,
    seed: int = 0,
    begin: Begin = unseen,
) -> DistanceGrid:
    """Signed distances to the surface that the images and masks of ``views`` show.

    ``cells`` along the longest side of the object; ``steps`` of the fit, 0 for what stereo finds; ``tolerated`` as for
    :func:`visual_hull`; ``exposures_differ`` where each image has a factor that nobody knows, which is then fitted;
    ``photographs`` of the views where these may move on their picture planes, and have moved when this returns; ``turns``
    (V, 3, 3) where the light turns: they take directions of the object, view by view, into those of the light. ``begin`` shows
    how far it is.

    Raises InputError for fewer views than tell a surface.
    """
    if len(views) < LEAST_VIEWS:
        raise InputError(
            f"capture.geometry=sdf: expected at least {LEAST_VIEWS} training views, found {len(views)}; "
            "capture.geometry=hull needs masks alone"
        )
    if not any((view.image > 0).any() for view in views):
        raise InputError("capture.geometry=sdf: expected images that show something, found all of them black")
    hull = visual_hull(views, cells, tolerated)
    starts = [fused(hull, depth_maps(views, hull, begin))]
    if steps == 0:
        return starts[0]
    if turns is not None:  # what lies still under such a light is not alike from view to view: what stereo found may mislead
        starts.append(hull)
    pixels, least = pixels_of(views, hull), hull.values / hull.step - BEYOND

    def refined(start: DistanceGrid, steps: int, moving: MovingPhotographs | None) -> tuple[Tensor, float]:
        fit = _Fit(pixels, len(views) if exposures_differ else 0, moving, turns, seed)
        return fit.refined(start.values / hull.step, least, begin("surface from images", steps))

    torch.set_flush_denormal(True)  # features that no ray meets decay to numbers that are slow to compute with
    try:
        if len(starts) > 1:
            tried = [refined(start, max(steps // TRIAL, 1), None)[1] for start in starts]
            starts = [starts[int(np.argmin(np.nan_to_num(tried, nan=np.inf)))]]
        values, _ = refined(starts[0], steps, photographs)
    finally:
        torch.set_flush_denormal(False)
    return DistanceGrid(values * hull.step, hull.low, hull.step)


def _near_surface(values: Tensor) -> Tensor:
    """The flat indices of inner vertices near the surface."""
    inner = torch.zeros(values.shape, dtype=torch.bool)
    inner[1:-1, 1:-1, 1:-1] = values[1:-1, 1:-1, 1:-1].abs() < BAND
    return inner.reshape(-1).nonzero()[:, 0]


def _irregularity(values: Tensor, near: Tensor) -> Tensor:
    """EIKONAL (|grad f| - 1)^2 + SMOOTH (laplacian f)^2, by differences of neighbours, in the mean over the vertices ``near``."""
    flat = values.reshape(-1)
    laplacian, squared = -6 * flat[near], torch.zeros(len(near))
    for stride in values.stride():
        after, before = flat[near + stride], flat[near - stride]
        laplacian = laplacian + after + before
        squared = squared + (0.5 * (after - before)) ** 2
    return EIKONAL * (((squared + 1e-12).sqrt() - 1) ** 2).mean() + SMOOTH * (laplacian**2).mean()


class _Fit:
    """What is fitted to ``pixels``: how the surface looks, and the exposures of so many ``images`` (0: all alike)."""

    def __init__(
        self, pixels: Pixels, images: int, photographs: MovingPhotographs | None, turns: np.ndarray | None, seed: int
    ) -> None:
        self._pixels = pixels
        self._photographs = photographs
        self._turns = None if turns is None else torch.from_numpy(turns).float()
        self._random = torch.Generator().manual_seed(seed)
        self._appearance = Appearance(self._random, shaded=turns is not None)
        self._gains = torch.zeros(images, requires_grad=images > 0)  # logarithms
        shown = (pixels.mask > 0.5) & (pixels.colour_known > 0)
        mean = float(pixels.colour[shown].mean()) if shown.any() else 1.0
        self._mean = max(mean, 1e-12)

    def refined(self, start: Tensor, least: Tensor, task: ProgressBar) -> tuple[Tensor, float]:
        """Distances (X, Y, Z) in cells after the steps of ``task`` from ``start``, never below ``least``, and the loss of the last.

        The loss is the mean over the last quarter of the steps; fits of one seed see the same pixels.
        """
        steps, losses = task.total, list[float]()
        sizes = [[-(-(count - 1) // 2**level) + 1 for count in start.shape] for level in range(LEVELS)]
        moves = [torch.zeros(size, requires_grad=True) for size in sizes]
        features = torch.zeros(*start.shape, CHANNELS)
        features[..., :3] = DARK
        features.grad = torch.zeros_like(features)
        rates = DISTANCE_RATE, FEATURE_RATE, NETWORK_RATE, GAIN_RATE, OFFSET_RATE
        gains, offsets = [self._gains] if len(self._gains) else [], [self._photographs.offsets] if self._photographs else []
        parts = moves, [features], list(self._appearance.parameters()), gains, offsets
        groups = [{"params": part, "lr": rate, "initial_lr": rate} for part, rate in zip(parts, rates, strict=True) if part]
        optimiser = torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-10, fused=True)
        near = _near_surface(start)
        for step in range(steps):
            for group in optimiser.param_groups:
                group["lr"] = group["initial_lr"] * FALL ** (step / steps)
            if step < WARM * steps:
                for place in (0, -1) if offsets else (0,):
                    optimiser.param_groups[place]["lr"] = 0.0
            values = _moved(start, moves, least)
            if step % AGAIN == 0:
                near = _near_surface(values.detach())
            loss = self._misfit(values, features) + _irregularity(values, near)
            optimiser.zero_grad(set_to_none=False)
            loss.backward()
            optimiser.step()
            losses.append(float(loss.detach()))
            task.advance(loss=losses[-1])
            if len(self._gains):
                with torch.no_grad():
                    self._gains -= self._gains.mean()  # what all factors have in common, the colours have
            if self._photographs is not None:
                with torch.no_grad():
                    self._photographs.offsets[:, 3] -= self._photographs.offsets[:, 3].mean()  # and the size of the surface
        with torch.no_grad():
            return _moved(start, moves, least), float(np.mean(losses[-max(steps // 4, 1) :]))

    def _misfit(self, values: Tensor, features: Tensor) -> Tensor:
        """Of random pixels, the mean difference of colours and MASK times that of coverages."""
        pixels = self._pixels
        runs = max(len(pixels.mask) // RUN, 1)
        first = torch.randint(runs, (BATCH // RUN,), generator=self._random).sort().values
        picked = (first[:, None] * RUN + torch.arange(RUN)).reshape(-1).clamp_max(len(pixels.mask) - 1)
        rays = pixels.rays.chosen(picked)
        rays.near.add_(STRIDE * torch.rand(len(picked), generator=self._random))  # segments end elsewhere at every step
        found, opacity, distance = gathered(values, features.detach(), rays, WIDTH, STRIDE, features.grad)
        safe = opacity.clamp_min(1e-2)
        place = rays.origins + (distance / safe).detach()[:, None] * rays.directions
        gradients = sampled(torch.stack(torch.gradient(values)), torch.zeros(3), torch.tensor(values.shape) - 1, place)
        normals, directions = normalize(gradients, dim=-1, eps=1e-6), rays.directions
        if self._turns is not None:
            turn = self._turns[pixels.view[picked]]
            normals, directions = (torch.einsum("nij,nj->ni", turn, each) for each in (normals, directions))
        colour = self._appearance(found / safe[:, None], normals, directions) * opacity[:, None]
        if len(self._gains):
            colour = colour * self._gains[pixels.view[picked]].exp()[:, None]
        given = pixels.colour, pixels.mask, pixels.colour_known, pixels.mask_known
        shown, mask, colour_known, mask_known = (one[picked] for one in given)
        if self._photographs is not None:
            shown, mask, colour_known, mask_known = self._photographs.at(pixels.view[picked], pixels.place[picked])
        apart = (torch.log1p(3 * colour) - torch.log1p(3 * shown / self._mean)).abs().mean(-1)
        loss = (colour_known * apart).mean() + MASK * (mask_known * (opacity - mask).abs()).mean()
        if self._photographs is not None:
            loss = loss + OFFSET * (self._photographs.offsets**2).mean()
        return loss


def _moved(values: Tensor, moves: Sequence[Tensor], least: Tensor) -> Tensor:
    """Distances and the sum of all moves, each interpolated to their grid, where that is not below ``least``."""
    for move in moves:
        same = move.shape == least.shape
        values = values + (move if same else interpolate(move[None, None], least.shape, mode="trilinear", align_corners=True)[0, 0])
    return torch.maximum(values, least)


# ---------------------------------------------------------------- colour, without a model of light
class Appearance(nn.Module):
    """Linear colour (N, 3) of features (N, CHANNELS), unit normals and directions of rays (N, 3): that of all views, and a shine.

    softplus(the first three features) + softplus(network(the other features, normal, mirrored direction, cosine)). Under light that
    does not move, the first is all that a matt surface shows, whatever its shadows. Under one that does, normals and directions are
    those that the light knows, and the first is ``shaded``: multiplied by exp(a linear function of the normal's harmonics).
    """

    def __init__(self, generator: torch.Generator, *, shaded: bool = False) -> None:
        super().__init__()
        self.shading = nn.Linear(15, 3) if shaded else None
        if self.shading is not None:
            nn.init.zeros_(self.shading.weight)
            nn.init.zeros_(self.shading.bias)
        sizes = CHANNELS - 3 + 2 * 15 + 1, HIDDEN, HIDDEN, 3
        layers = [nn.Linear(*pair) for pair in zip(sizes, sizes[1:], strict=False)]
        for layer in layers:
            bound = layer.in_features**-0.5
            with torch.no_grad():
                layer.weight.uniform_(-bound, bound, generator=generator)
                layer.bias.zero_()
        nn.init.constant_(layers[-1].bias, BEGINNING)
        self.network = nn.Sequential(layers[0], nn.ReLU(), layers[1], nn.ReLU(), layers[2])

    def forward(self, features: Tensor, normals: Tensor, directions: Tensor) -> Tensor:
        """See the class."""
        cosine = (normals * directions).sum(-1, keepdim=True)
        mirrored = directions - 2 * cosine * normals
        of_normals = harmonics(normals)
        known = torch.cat([features[:, 3:], of_normals, harmonics(mirrored), cosine], -1)
        matt = softplus(features[:, :3])
        return (matt if self.shading is None else matt * self.shading(of_normals).exp()) + softplus(self.network(known))


def harmonics(d: Tensor) -> Tensor:
    """Real spherical harmonics of degrees 1 to 3 at unit directions (N, 3), each up to a factor: (N, 15)."""
    x, y, z = d.unbind(-1)
    first = [x, y, z]
    second = [x * y, y * z, x * z, x * x - y * y, 3 * z * z - 1]
    third = [x * (x * x - 3 * y * y), y * (3 * x * x - y * y), z * (x * x - y * y), x * y * z]
    third += [x * (5 * z * z - 1), y * (5 * z * z - 1), z * (5 * z * z - 3)]
    return torch.stack(first + second + third, -1)
