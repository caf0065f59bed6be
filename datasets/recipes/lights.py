"""The lights of the benchmark: one training light per scene, three novel lights for relighting.

Photographed ones (`photographs.py`) are called `photo_...`. Every other is a function of direction, so it can be
rasterised at any resolution. Values are relative radiance; `make_light` scales each to the same mean, at which a white
diffuse sphere averages 0.6 and objects about 0.3.
"""

import numpy as np
from latlong import Radiance, rasterise
from numpy.typing import NDArray
from photographs import PREFIX, photographed_light
from real import PREFIX as REAL_PREFIX
from real import real_light

BRIGHTNESS = 0.6
"""Mean luminance of every light over the sphere of directions."""

NOVEL_LIGHTS = ("studio", "sunset", "night")

Array = NDArray[np.float64]


# -- building blocks ---------------------------------------------------------------------------------------------------
def rgb(red: float, green: float, blue: float) -> Array:
    """A linear Rec.709 colour (3,)."""
    return np.array([red, green, blue])


def toward(azimuth: float, elevation: float) -> Array:
    """Unit direction (3,) of an azimuth from +x toward +y and an elevation, in degrees."""
    a, e = np.radians((azimuth, elevation))
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def ramp(x: Array, start: float, end: float) -> Array:
    """Smooth step (...) from 0 at `start` to 1 at `end`; `start` may be the larger."""
    t = np.clip((x - start) / (end - start), 0.0, 1.0)
    return t * t * (3 - 2 * t)


def mix(a: Array, b: Array, weight: Array) -> Array:
    """Colours (..., 3) between a and b; `weight` (...)."""
    return a + (b - a) * weight[..., None]


def elevation(d: Array) -> Array:
    """Elevation (...) of directions (..., 3), degrees."""
    return np.degrees(np.arcsin(np.clip(d[..., 2], -1.0, 1.0)))


def angle_to(d: Array, axis: Array) -> Array:
    """Angle (...) between directions (..., 3) and an axis (3,), degrees."""
    return np.degrees(np.arccos(np.clip(d @ axis, -1.0, 1.0)))


def disc(d: Array, axis: Array, diameter: float, edge: float = 0.6) -> Array:
    """Weight (...) of a disc around `axis`, `diameter` degrees wide, its rim softened over `edge` degrees."""
    return ramp(angle_to(d, axis), (diameter + edge) / 2, (diameter - edge) / 2)


def glow(d: Array, axis: Array, width: float) -> Array:
    """Weight (...) of a soft halo around `axis` that falls to 1/e within about `width` degrees."""
    return np.exp(-angle_to(d, axis) / width)


def panel(d: Array, axis: Array, width: float, height: float, edge: float) -> Array:
    """Weight (...) of an upright rectangle of `width` x `height` degrees around `axis`."""
    right = np.cross((0.0, 0.0, 1.0), axis)
    right /= np.linalg.norm(right)
    depth = d @ axis
    safe = np.where(depth > 1e-3, depth, 1.0)  # directions behind the panel's plane are masked below
    x, y = np.abs(d @ right) / safe, np.abs(d @ np.cross(axis, right)) / safe
    x, y = np.degrees(np.arctan(x)), np.degrees(np.arctan(y))
    inside = ramp(x, (width + edge) / 2, (width - edge) / 2) * ramp(y, (height + edge) / 2, (height - edge) / 2)
    return np.where(depth > 1e-3, inside, 0.0)


def noise(d: Array, frequency: float, seed: int, octaves: int = 4) -> Array:
    """Smooth fractal noise (...) of unit variance, without a seam: octaves of random plane waves over the sphere."""
    rng = np.random.default_rng(seed)
    total, variance = np.zeros(d.shape[:-1]), 0.0
    for octave in range(octaves):
        amplitude = 0.55**octave
        for wave in rng.normal(size=(10, 3)) * frequency * 2.0**octave:
            total += amplitude * np.cos(d @ wave + rng.uniform(0, 2 * np.pi))
            variance += amplitude**2 / 2
    return total / np.sqrt(variance)


# -- training lights ---------------------------------------------------------------------------------------------------
def garden(d: Array) -> Array:
    """hat: overcast sky with a soft sun behind thin cloud, hedges, a lawn."""
    sun, up = toward(-50, 52), elevation(d)
    clouds = 1 + 0.22 * noise(d, 3.0, seed=1)
    sky = mix(rgb(0.78, 0.82, 0.86), rgb(0.62, 0.72, 0.90), ramp(up, 0, 80)) * np.maximum(clouds, 0.2)[..., None]
    sky += 5.0 * glow(d, sun, 14.0)[..., None] * rgb(1.0, 0.95, 0.86)
    sky += 40.0 * disc(d, sun, 11.0, edge=5.0)[..., None] * rgb(1.0, 0.94, 0.82)
    leaves = np.exp(0.5 * noise(d, 14.0, seed=2, octaves=3))
    hedge = 0.6 * leaves[..., None] * rgb(0.10, 0.17, 0.06)
    lawn = leaves[..., None] * mix(rgb(0.16, 0.30, 0.07), rgb(0.22, 0.34, 0.10), ramp(noise(d, 4.0, seed=3), -1, 1))
    skyline = 7.0 + 3.5 * noise(d * rgb(1, 1, 0), 5.0, seed=4, octaves=3)
    ground = mix(hedge, lawn, ramp(up, -2, -5))
    return mix(ground, sky, ramp(up - skyline, -1.0, 1.0))


def harbour(d: Array) -> Array:
    """ship: blue sky, a low hard sun thousands of times brighter, hazy horizon, quay, glittering water."""
    sun, up = toward(48, 24), elevation(d)
    sky = mix(rgb(0.75, 0.72, 0.66), rgb(0.10, 0.25, 0.72), ramp(up, -8, 55))
    wisps = ramp(noise(d * rgb(1, 1, 3), 2.2, seed=11), 0.5, 2.2)
    sky = mix(sky, rgb(0.95, 0.93, 0.90), 0.7 * wisps)
    sky += 2.2 * glow(d, sun, 9.0)[..., None] * rgb(1.0, 0.86, 0.62)
    sky += 5200.0 * disc(d, sun, 3.6)[..., None] * rgb(1.0, 0.87, 0.66)
    ripples = np.exp(0.35 * noise(d * rgb(1, 1, 6), 9.0, seed=12, octaves=3))
    water = ripples[..., None] * mix(rgb(0.05, 0.12, 0.16), rgb(0.28, 0.36, 0.42), ramp(up, -50, 0))
    mirrored = d * rgb(1, 1, -1)
    water += 5.0 * (glow(mirrored, sun, 7.0) * ripples**3)[..., None] * rgb(1.0, 0.84, 0.60)
    azimuth = np.degrees(np.arctan2(d[..., 1], d[..., 0]))
    roofs = 5.0 + 3.0 * np.sign(np.sin(azimuth * 0.31)) + 1.5 * np.sign(np.sin(azimuth * 0.83 + 1.0))
    quay = ramp(np.abs(azimuth + 120.0), 62, 60) * ramp(up, -1.2, -0.8) * ramp(up - roofs, 0.4, -0.4)
    return mix(mix(water, sky, ramp(up, -0.4, 0.4)), rgb(0.16, 0.11, 0.09), quay)


def lamp_room(d: Array) -> Array:
    """console: a room with ochre walls and warm lamps, so that everything in it looks yellow."""
    up, lamp = elevation(d), rgb(1.0, 0.70, 0.20)
    stripes = 1 + 0.10 * np.sign(np.sin(12 * np.arctan2(d[..., 1], d[..., 0])))
    wall = stripes[..., None] * mix(rgb(0.30, 0.19, 0.045), rgb(0.52, 0.36, 0.09), ramp(up, -30, 45))
    ceiling = rgb(0.75, 0.56, 0.17) * (1 + 0.05 * noise(d, 5.0, seed=21))[..., None]
    planks = 1 + 0.18 * noise(d * rgb(1, 6, 1), 6.0, seed=22, octaves=2)
    floor = np.maximum(planks, 0.3)[..., None] * rgb(0.19, 0.11, 0.03)
    room = mix(mix(floor, wall, ramp(up, -29, -27)), ceiling, ramp(up, 44, 46))
    lamps = ((20, 58, 13, 60), (140, 35, 16, 36), (-115, 48, 10, 70), (-60, 12, 14, 26), (85, 5, 8, 40))
    for azimuth, height, diameter, power in lamps:
        axis = toward(azimuth, height)
        room = room + 0.8 * glow(d, axis, 12.0)[..., None] * lamp
        room = mix(room, power * lamp, disc(d, axis, diameter, edge=2.0))
    return room


def spotlight(d: Array) -> Array:
    """figurine: one small hard window in a dim room, a weak bluish fill from the other side."""
    up, key = elevation(d), toward(-35, 46)
    room = mix(rgb(0.055, 0.050, 0.048), rgb(0.095, 0.092, 0.095), ramp(up, -40, 60))
    room = room * (1 + 0.12 * noise(d, 3.5, seed=31))[..., None]
    room += 0.35 * panel(d, toward(150, 18), 55, 40, edge=10.0)[..., None] * rgb(0.75, 0.90, 1.10)
    room += 0.6 * glow(d, key, 8.0)[..., None]
    return room + 1000.0 * panel(d, key, 4.6, 4.6, edge=0.6)[..., None] * rgb(1.0, 0.95, 0.88)


def snowfield(d: Array) -> Array:
    """tiny: turquoise sky, a rosy sun, mountains, snow."""
    sun, up = toward(115, 38), elevation(d)
    sky = mix(rgb(0.62, 0.66, 0.72), rgb(0.06, 0.36, 0.46), ramp(up, 0, 60))
    sky = mix(sky, rgb(0.85, 0.80, 0.86), 0.6 * ramp(noise(d, 2.4, seed=41, octaves=3), 0.4, 2.0))
    sky += 1.5 * glow(d, sun, 10.0)[..., None] * rgb(1.0, 0.80, 0.70)
    sky += 1600.0 * disc(d, sun, 5.6)[..., None] * rgb(1.0, 0.76, 0.66)
    snow = rgb(0.42, 0.44, 0.58) * (1 + 0.12 * noise(d, 3.0, seed=42, octaves=3))[..., None]
    peaks = 8.0 + 4.0 * noise(d * rgb(1, 1, 0), 4.0, seed=43, octaves=3)
    rock = rgb(0.13, 0.13, 0.19) * np.exp(0.4 * noise(d, 9.0, seed=44, octaves=2))[..., None]
    land = mix(snow, rock, ramp(up, -0.5, 0.5))
    return mix(land, sky, ramp(up - peaks, -0.8, 0.8))


def workshop(d: Array) -> Array:
    """teaset: brick walls, a teal cupboard and tungsten lamps over a bench, one small cool window: orange on the whole."""
    up, tungsten = elevation(d), rgb(1.0, 0.52, 0.20)
    azimuth = np.degrees(np.arctan2(d[..., 1], d[..., 0]))
    courses = 1 + 0.15 * np.sign(np.sin(up * 1.6)) + 0.10 * noise(d * rgb(1, 1, 4), 8.0, seed=71, octaves=2)
    brick = np.maximum(courses, 0.3)[..., None] * mix(rgb(0.30, 0.105, 0.060), rgb(0.46, 0.19, 0.10), ramp(up, -20, 40))
    cupboard = ramp(np.abs(azimuth - 150.0), 31, 29) * ramp(up, 22, 20)
    wall = mix(brick, rgb(0.05, 0.17, 0.16), cupboard)
    boards = 1 + 0.2 * noise(d * rgb(7, 1, 1), 5.0, seed=72, octaves=2)
    bench = np.maximum(boards, 0.3)[..., None] * rgb(0.26, 0.14, 0.065)
    room = mix(mix(bench, wall, ramp(up, -24, -22)), rgb(0.34, 0.25, 0.17), ramp(up, 55, 58))
    for at, height, diameter, power in ((35, 48, 11, 75), (-80, 62, 14, 40), (-170, 30, 9, 60)):
        axis = toward(at, height)
        room = room + 0.7 * glow(d, axis, 12.0)[..., None] * tungsten
        room = mix(room, power * tungsten, disc(d, axis, diameter, edge=1.5))
    return mix(room, 9.0 * rgb(0.62, 0.85, 1.15), panel(d, toward(95, 24), 17, 22, edge=1.5))


def balcony(d: Array) -> Array:
    """owl: a low golden sun in a dim violet sky, a rose house wall behind, planted boxes, tiles below."""
    sun, up = toward(-28, 17), elevation(d)
    facing = 0.5 + 0.5 * np.cos(np.radians(angle_to(d, toward(-28, 0))))
    sky = mix(mix(rgb(0.20, 0.18, 0.34), rgb(0.60, 0.36, 0.34), facing**3), rgb(0.10, 0.12, 0.36), ramp(up, 0, 45))
    sky = mix(sky, rgb(0.42, 0.30, 0.42), 0.5 * ramp(noise(d * rgb(1, 1, 4), 2.4, seed=81), 0.5, 2.0))
    sky += 1.2 * glow(d, sun, 8.0)[..., None] * rgb(1.0, 0.74, 0.42)
    sky += 1500.0 * disc(d, sun, 4.0)[..., None] * rgb(1.0, 0.78, 0.50)
    azimuth = np.degrees(np.arctan2(d[..., 1], d[..., 0]))
    plaster = rgb(0.44, 0.22, 0.20) * (1 + 0.10 * noise(d, 6.0, seed=82, octaves=3))[..., None]
    house = ramp(np.abs(azimuth - 145.0), 51, 49) * ramp(up, 56, 54)
    leaves = rgb(0.07, 0.14, 0.045) * np.exp(0.5 * noise(d, 14.0, seed=83, octaves=3))[..., None]
    boxes = 5.0 + 2.5 * noise(d * rgb(1, 1, 0), 6.0, seed=84, octaves=3)
    tiles = 1 + 0.25 * np.sign(np.sin(18 * d[..., 0]) * np.sin(18 * d[..., 1]))
    ground = mix(tiles[..., None] * rgb(0.22, 0.13, 0.11), leaves, ramp(up, -19, -17))
    return mix(ground, mix(sky, plaster, house), ramp(up - np.minimum(boxes, 11.0), -0.8, 0.8))


def cellar(d: Array) -> Array:
    """owl_cellar: one bare bulb in a dim stone vault, a door ajar with greenish daylight behind it, a dark floor."""
    up, bulb = elevation(d), toward(65, 40)
    stones = np.exp(0.3 * noise(d * rgb(1, 1, 2), 7.0, seed=91, octaves=3))
    vault = stones[..., None] * mix(rgb(0.060, 0.055, 0.050), rgb(0.085, 0.080, 0.078), ramp(up, -10, 60))
    room = mix(stones[..., None] * rgb(0.035, 0.030, 0.026), vault, ramp(up, -14, -11))
    room = mix(room, 0.55 * rgb(0.80, 1.05, 0.85), panel(d, toward(-100, 8), 16, 44, edge=2.0))
    room += 0.5 * glow(d, bulb, 10.0)[..., None] * rgb(1.0, 0.85, 0.62)
    return room + 900.0 * disc(d, bulb, 5.0)[..., None] * rgb(1.0, 0.88, 0.68)


# -- novel lights ------------------------------------------------------------------------------------------------------
def studio(d: Array) -> Array:
    """Softboxes in front of a dark grey sweep: a large cool key, a warm strip, an overhead bank."""
    up = elevation(d)
    sweep = mix(rgb(0.10, 0.10, 0.10), rgb(0.035, 0.037, 0.042), ramp(up, -50, 50))
    boxes = (
        (toward(35, 38), 46, 34, 9.0, rgb(0.92, 0.97, 1.0)),
        (toward(-75, 20), 12, 60, 7.0, rgb(1.0, 0.86, 0.68)),
        (toward(170, 62), 50, 24, 5.0, rgb(1.0, 1.0, 1.0)),
    )
    for axis, width, height, power, colour in boxes:
        falloff = 0.55 + 0.45 * glow(d, axis, 25.0)  # the lamp shows through the diffuser
        sweep = mix(sweep, power * falloff[..., None] * colour, panel(d, axis, width, height, edge=1.5))
    return sweep


def sunset(d: Array) -> Array:
    """A low orange sun, burning horizon, violet sky, dark ground."""
    sun, up = toward(-140, 9), elevation(d)
    facing = 0.5 + 0.5 * np.cos(np.radians(angle_to(d, toward(-140, 0))))
    horizon = mix(rgb(0.32, 0.22, 0.34), rgb(1.5, 0.55, 0.14), facing**2)
    sky = mix(horizon, rgb(0.09, 0.11, 0.30), ramp(up, -5, 50))
    streaks = ramp(noise(d * rgb(1, 1, 5), 2.6, seed=51), 0.2, 1.8)
    sky = mix(sky, mix(rgb(0.35, 0.20, 0.26), rgb(1.6, 0.70, 0.28), facing**2), 0.7 * streaks)
    sky += 2.5 * glow(d, sun, 10.0)[..., None] * rgb(1.0, 0.50, 0.16)
    sky += 1500.0 * disc(d, sun, 4.2)[..., None] * rgb(1.0, 0.55, 0.20)
    ground = rgb(0.050, 0.036, 0.030) * np.exp(0.4 * noise(d, 6.0, seed=52, octaves=3))[..., None]
    hills = 2.0 + 1.2 * noise(d * rgb(1, 1, 0), 5.0, seed=53, octaves=3)
    return mix(ground, sky, ramp(up - hills, -0.5, 0.5))


def night(d: Array) -> Array:
    """Dark blue night with a moon, street lamps, and neon signs in several colours."""
    up = elevation(d)
    sky = mix(rgb(0.030, 0.040, 0.085), rgb(0.010, 0.016, 0.050), ramp(up, 0, 70))
    ground = rgb(0.020, 0.018, 0.022) * np.exp(0.5 * noise(d, 7.0, seed=61, octaves=3))[..., None]
    scene = mix(ground, sky, ramp(up, -1, 1))
    moon = toward(70, 55)
    scene = scene + 0.25 * glow(d, moon, 12.0)[..., None] * rgb(0.8, 0.9, 1.0)
    scene = mix(scene, 45.0 * rgb(0.80, 0.90, 1.0), disc(d, moon, 6.0))
    for azimuth, height, colour in ((-20, 30, (1.0, 0.62, 0.25)), (-165, 24, (1.0, 0.62, 0.25))):
        scene = mix(scene, 60.0 * rgb(*colour), disc(d, toward(azimuth, height), 7.0, edge=1.5))
    signs = (
        (-85, 18, 26, 7, (1.0, 0.08, 0.42)),
        (120, 12, 8, 34, (0.05, 0.85, 0.90)),
        (30, 6, 30, 5, (0.25, 1.0, 0.20)),
        (165, 40, 20, 6, (0.35, 0.20, 1.0)),
    )
    for azimuth, height, width, tall, colour in signs:
        axis = toward(azimuth, height)
        scene = scene + 0.25 * glow(d, axis, 10.0)[..., None] * rgb(*colour)
        scene = mix(scene, 12.0 * rgb(*colour), panel(d, axis, width, tall, edge=1.5))
    return scene


MODELS: dict[str, Radiance] = {
    model.__name__: model
    for model in (garden, harbour, lamp_room, spotlight, snowfield, workshop, balcony, cellar, studio, sunset, night)
}


def make_light(name: str, height: int) -> NDArray[np.float32]:
    """Light (height, 2 height, 3), linear radiance, mean luminance BRIGHTNESS.

    Raises:
        ValueError: if no light has that name, or a photographed one cannot be had.
    """
    if name.startswith(PREFIX):
        return photographed_light(name.removeprefix(PREFIX), height, BRIGHTNESS)
    if name.startswith(REAL_PREFIX):
        return real_light(name.removeprefix(REAL_PREFIX), height, BRIGHTNESS)
    if name not in MODELS:
        raise ValueError(f"light must be one of {', '.join(MODELS)}, got {name!r}")
    return rasterise(MODELS[name], height, BRIGHTNESS)
