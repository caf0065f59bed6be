"""What each scene consists of: its light, its views, its resolutions, its sample counts."""

from dataclasses import dataclass, replace

from lights import NOVEL_LIGHTS
from real import PREFIX as REAL_PREFIX


@dataclass(frozen=True)
class Recipe:
    """A scene: object `objects/<object>.py` under the training light `light`, and in novel views under `novel_lights`.

    Sources with more than the share `least_power` of a light's power are rendered apart (light_parts.py), which costs some paths.
    An object that is a file, `objects/.../NAME.glb`, is one of `make real-data` (scanned.py); `metal` says that parts of it are.
    `samples` are paths a pixel of each split's views, and of the direct-light images ("direct").
    """

    object: str
    light: str
    samples: dict[str, int]
    views: dict[str, int]
    size: int = 128
    light_height: int = 256
    texture_size: int = 512
    novel_lights: tuple[str, ...] = NOVEL_LIGHTS
    metal: bool = False
    least_power: float = 0.01

    @property
    def scanned(self) -> bool:
        """Whether the object is a file, and not modelled in code."""
        return self.object.endswith(".glb")

    @property
    def lights(self) -> dict[str, str]:
        """Model of every light by its name in the scene: `train`, then the novel ones."""
        return {"train": self.light} | {name: name for name in self.novel_lights}

    def at_size(self, size: int) -> "Recipe":
        """The same recipe for images of another size; textures grow with larger images, up to 2048."""
        factor = max(1, size // self.size)
        return replace(self, size=size, texture_size=min(2048, self.texture_size * factor))

    def with_samples(self, samples: int) -> "Recipe":
        """The same recipe with another number of paths a pixel, for every view."""
        return replace(self, samples=dict.fromkeys(self.samples, samples))


PAPER_VIEWS = {"train": 100, "test": 20, "novel": 20}
"""Views per split; novel views are rendered once per light."""

TINY_VIEWS = {"train": 16, "test": 4, "novel": 4}

PAPER_SAMPLES = {"train": 256, "test": 512, "novel": 512, "direct": 1024}
"""Scores see the noise of each test and novel view; a fit averages over a hundred training views."""

SHORT_SAMPLES = {"train": 128, "test": 192, "novel": 128, "direct": 256}
"""What the time allowed when the shipped `hat` was rendered."""

DEVELOPMENT_VIEWS = {"train": 60, "test": 8, "novel": 8}

DEVELOPMENT_SAMPLES = dict.fromkeys(PAPER_SAMPLES, 32)
"""Minutes on one core. The noise of test and novel views is 29 to 37 dB of sRGB."""

PHOTOGRAPHED_SAMPLES = dict.fromkeys(PAPER_SAMPLES, 64)
"""Minutes on one core. The noise of test and novel views is 32 to 40 dB of sRGB."""

PHOTOGRAPHED_LIGHTS = ("photo_studio", "photo_venice", "photo_workshop")
"""Novel lights of the scenes that are lit by photographs: two lamps in the dark, a blue dusk, a hall with roof lights."""

DEVELOPMENT_LIGHTS = ("photo_bridge", "photo_dawn", "photo_hall")
"""Novel lights of development scenes under photographs, none of which lights a scene that is scored."""

TINY_SAMPLES = dict.fromkeys(PAPER_SAMPLES, 1024)


def photographed(name: str, light: str) -> Recipe:
    """The recipe of an object under photographed lights."""
    return Recipe(name, light, PHOTOGRAPHED_SAMPLES, PAPER_VIEWS, novel_lights=PHOTOGRAPHED_LIGHTS)


SCAN_LIGHTS = ("christmas_photo_studio_07", "kloppenheim_05", "st_peters_square_night", "thatch_chapel")
"""Light of the scans: a studio, a field, a square at night, a chapel; of the set "scans" of datasets/real/sources.toml."""


def scanned(path: str, light: int, *, metal: bool) -> Recipe:
    """The recipe of a scanned or artist-made object of `make real-data` under one of SCAN_LIGHTS; the others are its novel ones."""
    names = [REAL_PREFIX + name for name in SCAN_LIGHTS]
    novel = (*names[:light], *names[light + 1 :])
    size, texture, samples = 256, 1024, PHOTOGRAPHED_SAMPLES
    return Recipe(
        path, names[light], samples, PAPER_VIEWS, size, texture_size=texture, novel_lights=novel, metal=metal, least_power=0.04
    )


RECIPES = {
    "hat": Recipe("hat", "garden", SHORT_SAMPLES, PAPER_VIEWS),
    "ship": Recipe("ship", "harbour", PAPER_SAMPLES, PAPER_VIEWS),
    "console": Recipe("console", "lamp_room", PAPER_SAMPLES, PAPER_VIEWS),
    "figurine": Recipe("figurine", "spotlight", PAPER_SAMPLES, PAPER_VIEWS),
    "tiny": Recipe("tiny", "snowfield", TINY_SAMPLES, TINY_VIEWS, size=32, light_height=64, texture_size=128),
    "tiny_full": Recipe("tiny", "snowfield", PAPER_SAMPLES, PAPER_VIEWS),  # for tuning; not shipped
    "teaset": Recipe("teaset", "workshop", DEVELOPMENT_SAMPLES, DEVELOPMENT_VIEWS),  # likewise
    "owl": Recipe("owl", "balcony", DEVELOPMENT_SAMPLES, DEVELOPMENT_VIEWS),  # likewise
    "owl_cellar": Recipe("owl", "cellar", DEVELOPMENT_SAMPLES, DEVELOPMENT_VIEWS),  # likewise
    "owl_forest": Recipe("owl", "photo_forest", DEVELOPMENT_SAMPLES, DEVELOPMENT_VIEWS, novel_lights=DEVELOPMENT_LIGHTS),
    "teaset_lobby": Recipe("teaset", "photo_lobby", DEVELOPMENT_SAMPLES, DEVELOPMENT_VIEWS, novel_lights=DEVELOPMENT_LIGHTS),
    "book": photographed("book", "photo_apartment"),  # for the table `value`; not shipped
    "fruit": photographed("fruit", "photo_city"),  # likewise
    "drum": photographed("drum", "photo_sky"),  # likewise
    "bear": photographed("bear", "photo_esplanade"),  # likewise
    # For the table `scans`; not shipped. Chosen, with their lights, before any fit of them was seen.
    "tea_set": scanned("objects/polyhaven/tea_set_01.glb", 0, metal=True),
    "marble_bust": scanned("objects/polyhaven/marble_bust_01.glb", 1, metal=False),
    "painted_stool": scanned("objects/polyhaven/painted_wooden_stool.glb", 2, metal=False),
    "bookshelf": scanned("objects/polyhaven/wooden_bookshelf_worn.glb", 3, metal=False),
    "coffee_grinder": scanned("objects/pcf/coffee_grinder.glb", 1, metal=True),
    "wheelchair": scanned("objects/pcf/wheelchair.glb", 0, metal=False),
    "forklift": scanned("objects/pcf/forklift.glb", 3, metal=True),
    "tall_plant": scanned("objects/pcf/tall_plant.glb", 2, metal=False),
    "water_bottle": scanned("objects/gltf/waterbottle.glb", 1, metal=True),
    "boombox": scanned("objects/gltf/boombox.glb", 0, metal=True),
    "egyptian_cat": scanned("objects/gltf/egyptian_cat.glb", 3, metal=True),
    "avocado": scanned("objects/gltf/avocado.glb", 2, metal=False),
}
