"""Three books: an old cloth-bound one stands open on a printed paperback, which lies on a ledger with a leather back.

Print under soft gloss beside cloth, leather, marbled and yellowed paper; leaves that shade each other; a woven ribbon that
hangs from the head of the open book and over the paperback. About 20300 triangles.

Every part is a slab through grids of points, and carries the corner attribute 'chart' for painting: two coordinates on the
faces and which face it is, FRONT, BACK or the RIM, where the coordinates are the way round and the share of the thickness.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import bpy
import numpy as np

from . import book_paint as paints
from . import book_print as prints
from .forms import cells, mesh_object, smooth_path, store_chart, tube_along_curve

FLOOR = -0.652
LEDGER, LEDGER_THICK = (1.14, 0.90), 0.22  # along the spine, from spine to fore-edge
PAPERBACK, PAPERBACK_THICK = (1.02, 0.74), 0.11
COVER, LEAF = (0.62, 1.09), (0.575, 1.045)  # of the open book: from the spine outward, height
OPENING = 46.0  # of either board from the middle, degrees
ROOTS = 0.095  # half the thickness of the open book where it is sewn

Move = Callable[[np.ndarray], np.ndarray]


def build() -> None:
    """Build the three books in the empty scene, within the unit sphere."""
    _ledger(placed(-6.0, (0.0, 0.03, FLOOR)))
    _paperback(placed(-97.0, (0.02, -0.12, FLOOR + LEDGER_THICK + 0.002)))
    top = FLOOR + LEDGER_THICK + PAPERBACK_THICK
    stand = placed(7.0, (-0.02, 0.31, top + 0.004))
    _open_book(stand)
    _ribbon(stand, top)


# ---------------------------------------------------------------- slabs
def placed(degrees: float, origin: Sequence[float]) -> Move:
    """Turn points (..., 3) about z, then move them."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return lambda points: points @ turn.T + np.asarray(origin)


def slab(
    name: str, layers: Sequence[np.ndarray], chart: np.ndarray, paint: bpy.types.Material,
    kinds: Sequence[float | None] = (prints.FRONT, prints.BACK), sharp: float = 50.0,
) -> bpy.types.Object:  # fmt: skip
    """Solid between the first and the last of some grids of points (rows, columns, 3), whose rims are joined.

    `chart` (rows, columns, 2) is that of both faces, `kinds` the third number of the chart of the front and of the back; a
    face of which it is None lies on another part, is never seen and is left out.
    """
    rows, columns, _ = layers[0].shape
    index = np.arange(rows * columns).reshape(rows, columns)
    quads = cells(index)
    rim = np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])
    between = [layer.reshape(-1, 3)[rim] for layer in layers[1:-1]]
    points = np.concatenate([layers[0].reshape(-1, 3), layers[-1].reshape(-1, 3), *between])
    first = [rim, *(2 * rows * columns + len(rim) * k + np.arange(len(rim)) for k in range(len(between))), rows * columns + rim]
    flat = chart.reshape(-1, 2)
    faces, corners = [quads, quads[:, ::-1] + rows * columns], [flat[quads], flat[quads[:, ::-1]]]
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points[np.append(rim, rim[0])], axis=0), axis=1)))
    for k, (upper, lower) in enumerate(zip(first, first[1:], strict=False)):
        faces.append(np.stack([np.roll(upper, -1), upper, lower, np.roll(lower, -1)], axis=-1))
        s, t = np.stack([way[1:], way[:-1], way[:-1], way[1:]], axis=-1), np.array([k, k, k + 1, k + 1]) / (len(first) - 1)
        corners.append(np.stack([s, np.broadcast_to(t, s.shape)], axis=-1))
    kind = np.repeat(np.array([*kinds, prints.RIM], float), (len(quads), len(quads), (len(first) - 1) * len(rim)))
    quads, charts = np.concatenate(faces), np.concatenate(corners)
    corner = points[quads]
    volume = np.einsum("fk,fk->", corner.mean(axis=1), np.cross(corner[:, 1] - corner[:, 3], corner[:, 2] - corner[:, 0]))
    if volume < 0:  # this order of the corners faces inward
        quads, charts = quads[:, ::-1], charts[:, ::-1]
    seen = np.isfinite(kind)
    item = mesh_object(name, points, quads[seen].tolist(), paint, sharp)
    store_chart(item, np.concatenate([charts, np.broadcast_to(kind[:, None, None], (*charts.shape[:2], 1))], axis=-1)[seen])
    return item


def spread(start: float, end: float, count: int, margin: float = 0.012) -> np.ndarray:
    """Evenly spread numbers, and one more `margin` within either end, so that edges round off within it."""
    inner = np.linspace(start, end, count)
    step = margin * np.sign(end - start)
    return np.concatenate([[start, start + step], inner[1:-1], [end - step, end]])


def rounded(points: np.ndarray, half: tuple[float, float], radius: float) -> np.ndarray:
    """Points (..., 2) of a rectangle about the origin, drawn in at its corners to a radius."""
    size = np.abs(points)
    over = size - (np.asarray(half) - radius)
    inside = (over > 0).all(axis=-1, keepdims=True)
    reach = np.maximum(np.linalg.norm(over, axis=-1, keepdims=True), 1e-9)
    drawn = np.asarray(half) - radius + over * over.max(axis=-1, keepdims=True) / reach
    return np.sign(points) * np.where(inside, drawn, size)


def board(
    name: str, size: tuple[float, float], span: tuple[float, float], paint: bpy.types.Material, move: Move, *,
    bow: Callable[[np.ndarray], np.ndarray] | None = None, radius: float = 0.035, grid: tuple[int, int] = (11, 9),
    front: float = prints.FRONT,
) -> None:  # fmt: skip
    """Lying board of `size` about the origin from height span[0] to span[1], its edges rounded, lifted by `bow` (x, y)."""
    half = (size[0] / 2, size[1] / 2)
    x, y = np.meshgrid(spread(-half[0], half[0], grid[0]), spread(-half[1], half[1], grid[1]), indexing="ij")
    flat = rounded(np.stack([x, y], axis=-1), half, radius)
    lift = np.zeros_like(x) if bow is None else bow(flat)
    outward = np.sign(flat) * (np.abs(flat) >= np.asarray(half) - 0.5 * radius)
    edge = 0.3 * abs(span[1] - span[0])
    layers = [
        move(np.dstack([flat + grown * outward, lift + span[0] + share * (span[1] - span[0])]))
        for share, grown in ((1.0, 0.0), (0.75, edge), (0.25, edge), (0.0, 0.0))
    ]
    slab(name, layers, flat, paint, (front, prints.BACK), sharp=70.0)


# ---------------------------------------------------------------- books that lie
def _ledger(move: Move) -> None:
    """Thick volume: marbled boards, corners and a ribbed back of leather, a hollow fore-edge."""
    (height, width), thick, cover = LEDGER, LEDGER_THICK, 0.032
    hide = paints.half_leather(height, width)
    joint = 0.045
    shifted = (height, width - joint)

    def moved(points: np.ndarray) -> np.ndarray:
        return move(points + (0.0, joint / 2, 0.0))

    def sagging(flat: np.ndarray) -> np.ndarray:
        return 0.008 * np.sin(2.2 * flat[..., 0] + 0.6) * (flat[..., 1] / width + 0.5)

    board("lower board", shifted, (0.0, cover), hide, moved)
    board("upper board", shifted, (thick - cover, thick), hide, moved, bow=lambda f: np.minimum(sagging(f), 0.0))
    x = np.linspace(-height / 2 + 0.032, height / 2 - 0.032, 22)
    depth = np.linspace(0.0, 1.0, 7)
    layers = []
    for share in depth:
        hollow = 0.045 * (1.0 - (2 * share - 1) ** 2) * (1.0 + 0.1 * np.sin(9 * x))
        edge = width / 2 - 0.035 - hollow
        y = (-width / 2 + 0.02) + np.linspace(0.0, 1.0, 9) * (edge[:, None] + width / 2 - 0.02)
        z = np.full_like(y, cover - 0.004 + share * (thick - 2 * cover - 0.004))
        layers.append(move(np.dstack([np.repeat(x[:, None], 9, axis=1), y, z])))
    slab("ledger pages", layers, np.zeros((22, 9, 2)), prints.page_edges("ledger edges", True), (None, None))

    along = np.unique(np.concatenate([np.linspace(-0.5, 0.5, 13), *(b + np.linspace(-0.016, 0.016, 5) for b in paints.HUBS)]))
    turn = np.linspace(-1.0, 1.0, 13)
    hub = np.max([np.clip(1.0 - (np.abs(along - b) / 0.016) ** 4, 0.0, 1.0) for b in paints.HUBS], axis=0)
    layers = []
    for grown in (0.0, -0.020):
        bump = 0.014 * hub[:, None] * np.clip(1.3 - turn**6, 0.0, 1.0) * (grown == 0.0)
        bulge = (0.075 + grown + bump) * np.cos(turn * np.pi / 2) ** 0.8
        y = -width / 2 + joint + 0.01 - bulge
        z = thick / 2 + (thick / 2 + 0.004 + 0.4 * grown) * np.sin(turn * np.pi / 2) * np.ones_like(y)
        layers.append(move(np.dstack([np.repeat(along[:, None] * height, len(turn), axis=1), y, z])))
    chart = np.stack(np.meshgrid(along * height, turn, indexing="ij"), axis=-1)
    slab("ledger back", layers, chart, paints.leather_back(), sharp=60.0)


def _paperback(move: Move) -> None:
    """Soft cover in one sheet round a glued block; its free corner has curled up from being read."""
    (height, width), thick, cover = PAPERBACK, PAPERBACK_THICK, 0.010
    print_ = prints.cover(height, width)

    def curl(flat: np.ndarray) -> np.ndarray:
        free = np.clip((flat[..., 1] / width + 0.5 - 0.35) / 0.65, 0.0, 1.0)  # from the spine to the fore-edge
        low = np.clip((flat[..., 0] / height + 0.05) / 0.55, 0.0, 1.0)
        return 0.085 * free**2 * low**2

    for name, span, bow in (("back cover", (0.0, cover), None), ("front cover", (thick - cover, thick), curl)):
        board(name, (height, width), span, print_, move, bow=bow, radius=0.018, grid=(17, 13))
    along, across = np.linspace(-height / 2 + 0.008, height / 2 - 0.008, 21), np.linspace(-width / 2 + 0.012, width / 2 - 0.01, 15)
    x, y = np.meshgrid(along, across, indexing="ij")
    flat = np.stack([x, y], axis=-1)
    layers = []
    for share in np.linspace(0.0, 1.0, 8):
        slipped = 0.008 * np.sin(5.0 * share) * (y > 0)
        z = cover + share * (thick - 2 * cover) - 0.001 * (2 * share - 1) + curl(flat) * np.clip(2.2 * share - 1.3, 0.0, 0.9) ** 2
        layers.append(move(np.dstack([x, y + slipped, z])))
    slab("paperback pages", layers, flat, prints.page_edges("paperback edges", False), (None, None))
    along, turn = np.linspace(-height / 2, height / 2, 20), np.linspace(0.0, 1.0, 9)
    round_ = 0.007 + 0.011 * np.sin(np.pi * turn) ** 0.5
    layers = []
    for inward in (0.0, 0.010):
        points = np.zeros((20, 9, 3))
        points[..., 0], points[..., 1] = along[:, None], -width / 2 - round_ + inward + 0.004
        points[..., 2] = turn * thick
        layers.append(move(points))
    chart = np.stack(np.meshgrid(along, turn, indexing="ij"), axis=-1)
    slab("paperback back", layers, chart, prints.cover_back(height))


# ---------------------------------------------------------------- the open book
def fan(place: float, lengths: np.ndarray, curl: np.ndarray | float = 0.0) -> np.ndarray:
    """Section (n, ..., 2) of a leaf at `place` from -1 (left) to 1 along lengths (n,) from where it is sewn.

    It leaves the sewing nearly straight and bends to its own direction; beyond `place` .5 leaves lie on each other.
    """
    side, far = np.sign(place), abs(place)
    end = side * np.radians(np.interp(far, (0.0, 0.5, 1.0), (0.0, OPENING - 5.0, OPENING)))
    start = 0.45 * end
    share = lengths / LEAF[0]
    angle = (end + (start - end) * np.exp(-lengths / 0.075))[:, None] + share[:, None] ** 2 * np.atleast_1d(curl)
    heading = np.stack([np.sin(angle), -np.cos(angle)], axis=-1)
    middle = 0.5 * (heading[1:] + heading[:-1]) * np.diff(lengths)[:, None, None]
    walked = np.concatenate([np.zeros_like(middle[:1]), np.cumsum(middle, axis=0)])
    return walked + (ROOTS * place, 0.0)


def _open_book(move: Move) -> None:
    """Boards and back in cloth, two thick parts of the leaves against the boards, five leaves between, headbands."""
    cloth, paper = paints.cloth(*COVER), prints.page(*LEAF)
    inset = (COVER[1] - LEAF[1]) / 2
    lengths = LEAF[0] * np.linspace(0.0, 1.0, 22) ** 1.25
    heights = inset + np.linspace(0.0, LEAF[1], 11)
    chart = np.stack(np.meshgrid(lengths / LEAF[0], heights - inset, indexing="ij"), axis=-1)

    def upright(section: np.ndarray) -> np.ndarray:
        section = np.broadcast_to(section, (len(lengths), len(heights), 2))
        return move(np.dstack([section, np.broadcast_to(heights, section.shape[:2])]))

    for first, last, page in ((-1.0, -0.56, 0.0), (1.0, 0.60, 3.0)):
        layers = []
        for share in np.linspace(0.0, 1.0, 6):
            own = lengths * (1.0 - 0.035 * np.sin(np.pi * share))
            layers.append(upright(fan(first + share * (last - first), own)))
        slab("leaves", layers, chart, paper, (None, page))
    for number, (place, bend) in enumerate(((-0.43, 0.10), (-0.20, -0.16), (0.13, 0.12), (0.30, 0.22), (0.46, -0.10))):
        wave = bend * (0.35 + 0.65 * (heights - inset) / LEAF[1]) + 0.05 * np.sin(4.0 * heights + 2.0 * number)
        middle = fan(place, lengths, wave)
        along = np.gradient(middle, axis=0)
        normal = np.stack([-along[..., 1], along[..., 0]], axis=-1)
        normal *= 0.0028 / np.linalg.norm(normal, axis=-1, keepdims=True)
        slab("leaf", [upright(middle + normal), upright(middle - normal)], chart, paper, (number % 3 + 1, number % 3 + 2))

    hinges = []
    for side in (-1, 1):
        angle = side * np.radians(OPENING)
        ahead, out = np.array([np.sin(angle), -np.cos(angle)]), side * np.array([np.cos(angle), np.sin(angle)])
        outer = fan(float(side), lengths)
        offset = (outer[4:] @ out).max() + 0.004
        hinge = offset * out + ahead * (outer[0] @ ahead + 0.045)
        hinges.append(hinge + 0.014 * out)

        def standing(points: np.ndarray, hinge: np.ndarray = hinge, ahead: np.ndarray = ahead, out: np.ndarray = out) -> np.ndarray:
            x, y, z = (points[..., k, None] for k in range(3))
            section = hinge + (y + COVER[0] / 2) * ahead + z * out
            return move(np.concatenate([section, x + COVER[1] / 2], axis=-1))

        board(
            "board",
            (COVER[1], COVER[0]),
            (0.0, 0.028),
            cloth,
            standing,
            radius=0.03,
            front=prints.FRONT if side < 0 else prints.PLAIN,
        )

    left, right = hinges
    bend = smooth_path([(*left, 0.0), (*(left + (0.012, 0.055)), 0.0), (0.0, 0.092, 0.0), (*(right + (-0.012, 0.055)), 0.0),
                        (*right, 0.0)], 15)[:, :2]  # fmt: skip
    along = np.gradient(bend, axis=0)
    normal = np.stack([along[:, 1], -along[:, 0]], axis=-1) / np.linalg.norm(along, axis=1, keepdims=True)
    rise = spread(0.0, COVER[1], 12)
    layers = []
    for depth in (0.009, 0.0, -0.009):
        trim = 0.004 * (abs(depth) > 0.0)
        z = rise * (1 - 2 * trim / COVER[1]) + trim
        section = np.broadcast_to(bend - depth * normal, (len(rise), *bend.shape))
        layers.append(move(np.dstack([section, np.repeat(z[:, None], len(bend), axis=1)])))
    turn = np.linspace(-1.0, 1.0, len(bend))
    chart = np.stack(np.meshgrid(rise, turn, indexing="ij"), axis=-1)
    slab("back", layers, chart, paints.cloth_back(COVER[1]), sharp=60.0)
    for z in (inset - 0.004, COVER[1] - inset + 0.004):
        arc = np.linspace(-1.0, 1.0, 19)
        path = np.stack([0.9 * ROOTS * arc, 0.012 - 0.004 * arc**2, np.full(19, z)], axis=-1)
        tube_along_curve("headband", move(path), np.full(19, 0.013), paints.headband(), sides=8)


def _ribbon(stand: Move, top: float) -> None:
    """Woven marker: from behind the leaves over their head, down between them, over the paperback and its edge."""
    head = COVER[1] - 0.5 * (COVER[1] - LEAF[1])
    inner = [(0.0, 0.030, head - 0.06), (-0.002, 0.022, head + 0.012), (-0.004, -0.05, head + 0.030), (-0.008, -0.13, head + 0.006)]
    inner += [(-0.012, -0.165, head - 0.12), (-0.010, -0.150, 0.62), (-0.016, -0.165, 0.30), (-0.014, -0.175, 0.10)]
    path = [*stand(np.array(inner)), (0.0, 0.13, top + 0.030), (0.01, 0.06, top + 0.007), (0.045, -0.16, top + 0.007)]
    path += [(0.06, -0.36, top + 0.009), (0.075, -0.53, top + 0.014), (0.080, -0.625, top + 0.010), (0.085, -0.665, top - 0.04)]
    line = smooth_path([*path, (0.088, -0.655, top - 0.12), (0.10, -0.645, top - 0.20)], 90)
    ahead = np.gradient(line, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    share = np.linspace(0.0, 1.0, len(line))
    twist = 0.35 * np.sin(9.0 * share) * np.clip(2.0 - 4.0 * share, 0.0, 1.0)
    wide = np.stack([np.cos(twist), np.sin(twist), 0.0 * twist], axis=-1)
    wide -= ahead * (wide * ahead).sum(axis=1, keepdims=True)
    wide /= np.linalg.norm(wide, axis=1, keepdims=True)
    normal = np.cross(ahead, wide)
    across = np.linspace(-0.028, 0.028, 5)
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
    notch = np.zeros((len(line), 5))
    notch[-1] = 0.03 * (1.0 - np.abs(across) / 0.028)  # cut like a swallow's tail
    layers = []
    for side in (0.5, -0.5):
        cup = 0.004 * (1.0 - (across / 0.028) ** 2)
        middle = line[:, None] + across[None, :, None] * wide[:, None] - notch[..., None] * ahead[:, None]
        layers.append(middle + (cup[None, :, None] + side * 0.005) * normal[:, None])
    chart = np.stack(np.meshgrid(length, across, indexing="ij"), axis=-1)
    slab("ribbon", layers, chart, paints.ribbon())
