"""Predictions of any network as a prior: pictures in a folder, one or several for each training view. It sees nothing else.

The folder holds ``albedo/VIEW.png`` and the like, and may hold ``predictions.json``, which says how they are stored::

    {"albedo": {"files": "albedo/*", "encoding": "srgb", "alpha": "straight"}, "sees_truth": false,
     "declared": {"code": "github.com/someone/network", "hardware": "one GPU", "seconds": 40},
     "views": {"0001": {"size": [640, 480], "box": [0, -80, 640, 640], "exposure": 1.5}}}

``size`` (width, height) is that of the view, ``box`` (left, top, width, height) the part of it that pictures show, in its pixels,
which may reach beyond its edges, and ``exposure`` what its radiance was multiplied by: so ``ia-bench export --for prior`` wrote it.
"""

from __future__ import annotations

import glob
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
import torch
from PIL import Image
from pydantic import Field
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from ia_bench.common.declared import Declared
from ia_bench.common.errors import InputError, expect_distinct
from ia_bench.common.files import read_json, shown, user_path
from ia_bench.common.ranges import Positive
from ia_bench.common.seeds import derive_seed
from ia_bench.common.settings import parsed, parsed_file
from ia_bench.priors.contract import COMPONENTS, Observations, PriorInfo, Samples
from ia_bench.priors.diffusion.encoding import Frame, exposure, resized, window
from ia_bench.readers.pictures import SUFFIXES
from ia_bench.scenes.color import srgb_to_linear
from ia_bench.scenes.exr import expect_size_to_read
from ia_bench.scenes.images import display
from ia_bench.scenes.photograph import read_stored
from ia_bench.scenes.scene import View

ABOUT = "predictions.json"
FORMATS = (*SUFFIXES, ".npy")
ROUNDING = 0.01  # which lossy files and filters pass the ends of a range by
COVERED = 0.5  # of the object, at least, by a prediction's own alpha; less shows another view, or another part of it
ASPECT = 0.02  # relative difference of two aspects that rounding to whole pixels explains
FAINTEST = 1e-3  # a coverage below which nothing was predicted
Encoding = Literal["linear", "srgb"]
Alpha = Literal["straight", "premultiplied"]
Pixels = Annotated[int, Field(ge=1, lt=2**16)]
Place = Annotated[int, Field(gt=-(2**16), lt=2**16)]


@dataclass(frozen=True)
class PictureOf:
    """What the pictures of one view show of it; see the module."""

    size: tuple[Pixels, Pixels] | None = None
    box: tuple[Place, Place, Pixels, Pixels] | None = None
    exposure: Positive = 1.0


@dataclass(frozen=True)
class Stored:
    """Where the pictures of a component lie, and what their values mean; see :class:`FilesPrior`."""

    files: str | None = None
    encoding: Encoding | None = None
    alpha: Alpha | None = None


@dataclass(frozen=True)
class About:
    """What predictions.json holds."""

    albedo: Stored = field(default_factory=Stored)
    specular: Stored = field(default_factory=Stored)
    sees_truth: bool = False
    declared: Declared = field(default_factory=Declared)
    views: dict[str, Any] = field(default_factory=dict)


@dataclass(kw_only=True, eq=False)
class FilesPrior:
    """A sample of a view is one of the pictures that lie there for it, drawn by the seed; a single one is always taken.

    A picture is decoded, resized to its part of the view (means of what it covers, bilinear where it is coarser), and multiplied
    by the view's mask. Where its alpha covers nothing, the nearest colour stands. Specular shading is in the units of the
    photograph, divided by the exposure that it was shown with.

    An option wins over predictions.json, which may differ by component; an encoding or an alpha that neither says is asked for and
    never guessed.

    Attributes:
        path: The folder.
        albedo, specular: Where pictures lie below it, "*" standing for the name of a view: ``albedo/*`` by default means
            albedo/VIEW.png (or .exr, .npy, ...), or all pictures in a folder albedo/VIEW.
        encoding: "srgb" or "linear".
        alpha: "straight", or "premultiplied" where edges fade to black.
        sees_truth: Whether the predictions were made with knowledge of the truth; such a prior is marked in every table.

    Raises:
        InputError: There are no such pictures, or nobody says what they mean.
    """

    path: str | None = None
    albedo: str | None = None
    specular: str | None = None
    encoding: Encoding | None = None
    alpha: Alpha | None = None
    sees_truth: bool | None = None

    @classmethod
    def resolved_options(cls, options: Mapping[str, Any]) -> dict[str, Any]:
        """The options with the folder's absolute path, which identifies nothing: the files in it do."""
        path = options.get("path")
        return dict(options) if path is None else {**options, "path": str(user_path("prior.options.path", path, folder=True))}

    @classmethod
    def files(cls, options: Mapping[str, Any]) -> list[Path]:
        """The pictures and predictions.json."""
        made = cls(**options)
        pictures = [path for stored in made._stored.values() for path in made._all(stored)]
        return [path for path in (made._folder / ABOUT, *pictures) if path.is_file()]

    def __post_init__(self) -> None:
        if self.path is None:
            raise InputError("prior=files: expected prior.options.path=FOLDER, the folder of the predictions, found none")
        self._folder = user_path("prior.options.path", self.path, folder=True)
        place = self._folder / ABOUT
        about = parsed_file(About, place, read_json(place) if place.exists() else {})
        self._views = {name: parsed(PictureOf, view, f"{place}: views.{name}") for name, view in about.views.items()}
        self._stored: dict[str, Stored] = {}
        for name in COMPONENTS:
            said = getattr(about, name)
            files = getattr(self, name) or said.files
            stored = Stored(files or f"{name}/*", self.encoding or said.encoding, self.alpha or said.alpha)
            if self._all(stored):
                self._stored[name] = stored
            elif files:
                raise InputError(f"{self._folder}: expected pictures of {name} as {shown(stored.files)}, found none")
        if not self._stored:
            expected = f"predictions as albedo/VIEW.png (or {', '.join(FORMATS[1:])}), or specular/"
            raise InputError(f"{self._folder}: expected {expected}, found none")
        for name, stored in self._stored.items():
            for key, choices in (("encoding", Encoding), ("alpha", Alpha)):
                if getattr(stored, key) is None:
                    expected = f"{' or '.join(get_args(choices))}, there or as prior.options.{key}"
                    raise InputError(f"{place}: {name}.{key}: expected {expected}, found nothing")
        if self._views:
            several = any(len(self._of_view(one, name)) > 1 for one in self._stored.values() for name in self._views)
        else:  # a folder is that of a view's samples, or a part of the names of views
            several = any(path.parent != self._path(one, "x").parent for one in self._stored.values() for path in self._all(one))
        sees_truth = about.sees_truth if self.sees_truth is None else self.sees_truth
        self.info = PriorInfo(frozenset(self._stored), several, sees_truth=sees_truth, declared=about.declared)

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        """See :meth:`ia_bench.priors.contract.Prior.sample`. Of the observations only names and masks are looked at."""
        names = observations.names
        if names is None:
            raise InputError(
                "prior=files: expected training views of a scene, by whose names it finds files, found pictures without"
            )
        expect_distinct("prior=files: expected training views of different names", names)
        values = {}
        for component, stored in sorted(self._stored.items()):
            found = {name: self._of_view(stored, name) for name in names}
            missing = [name for name, paths in found.items() if not paths]
            if missing:
                some = shown(", ".join(missing[:5]) + (", ..." if len(missing) > 5 else ""))
                raise InputError(
                    f"{self._folder}: {stored.files}: expected {component} of every training view that is asked about, "
                    f"found none of {len(missing)} of {len(names)}: {some} (and {self._all(stored)[0].name} among others)"
                )
            drawn = [paths[derive_seed(seed, "files", name) % len(paths)] for name, paths in found.items()]
            sizes = observations.sizes or [tuple(observations.masks.shape[1:])] * len(names)
            rows = [self._view(component, *each) for each in zip(names, drawn, observations.masks, sizes, strict=True)]
            values[component] = torch.stack(rows) if rows else observations.images.clone()
        if "specular" not in values or self._stored["specular"].encoding == "linear":
            return Samples(values)
        ends = [1 / self._views.get(name, PictureOf()).exposure for name in names]  # what is encoded ends at white
        return Samples(values, {"specular": torch.tensor(ends)})

    # ---------------------------------------------------------------- which file
    def _path(self, stored: Stored, name: str) -> Path:
        """Where a view's picture lies, but for its suffix. Raises InputError for a pattern that leads elsewhere."""
        pattern = str(stored.files)
        if "*" not in pattern or Path(pattern).is_absolute() or ".." in Path(pattern).parts:
            expected = f"where files lie below {self._folder}, as 'albedo/*', the star standing for a view's name"
            raise InputError(f"prior=files: expected {expected}, found {shown(repr(pattern))}")
        return self._folder / pattern.replace("*", name)

    def _all(self, stored: Stored) -> list[Path]:
        """All pictures of a component, by name."""
        self._path(stored, "")
        pattern = glob.escape(str(stored.files)).replace("[*]", "*")  # the star alone means another thing than itself
        ends = (f"{pattern}{end}" for end in ("", ".*", "/*"))
        return sorted({path for end in ends for path in self._folder.glob(end.replace("*", "**/*", 1)) if _is_picture(path)})

    def _of_view(self, stored: Stored, name: str) -> list[Path]:
        """The pictures of a view, by name. Raises InputError for the same one in two formats, or beside a folder of samples."""
        path = self._path(stored, name)
        samples = sorted(each for each in path.iterdir() if _is_picture(each)) if path.is_dir() else []
        named = sorted(path.parent.glob(f"{glob.escape(path.name)}.*"))  # whose suffixes may be in upper case
        found = [path] if _is_picture(path) else [each for each in named if each.stem == path.name and _is_picture(each)]
        if len(found) + bool(samples) > 1:
            names = [*(each.name for each in found), *([f"{path.name}/{samples[0].name}"] if samples else [])]
            raise InputError(f"{path}: expected one picture, or a folder of samples, found {' and '.join(names)}")
        return samples or found

    # ---------------------------------------------------------------- what is in it
    def _view(self, component: str, name: str, path: Path, mask: Tensor, size: tuple[int, ...]) -> Tensor:
        """The prediction in a picture at the size of its view (H, W, 3), premultiplied by ``mask`` (H, W).

        A picture of which nothing is said shows the photograph, of that ``size`` (height, width).
        """
        (height, width), about = mask.shape, self._views.get(name, PictureOf())
        if about.size is not None and about.size != (width, height):
            said = f"{about.size[0]} x {about.size[1]} pixels"
            raise InputError(f"{self._folder / ABOUT}: expected view {name} with {said}, found {width} x {height}: another capture")
        left, top, across, down = about.box or (0, 0, *((width, height) if about.size else size[::-1]))
        if left >= width or top >= height or min(left + across, top + down) <= 0:
            raise InputError(f"{self._folder / ABOUT}: views.{name}.box: expected a part of {width} x {height}, found {about.box}")
        stored, share = _read(path)
        expect_size_to_read(path, across, down)  # which is what it is enlarged to
        if abs(stored.shape[1] * down / (stored.shape[0] * across) - 1) > max(ASPECT, 1 / min(stored.shape[:2])):
            found = f"{stored.shape[1]} x {stored.shape[0]}"
            raise InputError(
                f"{path}: expected the aspect of what it shows of view {name}, {across} x {down} pixels, found {found}"
            )
        if share is None:  # the network's own edges are not known: those of the view
            share = resized(window(mask[..., None], left, top, across, down), *stored.shape[:2])
        encoding, alpha = self._stored[component].encoding, self._stored[component].alpha
        straight = torch.where(share > 0, stored / share.clamp_min(1 / 255), 0) if alpha == "premultiplied" else stored
        end = torch.inf if (component, encoding) == ("specular", "linear") else 1.0
        inside = stored[(share > 0).expand_as(stored)]
        if inside.numel() and not (inside.min() >= -ROUNDING and inside.max() <= end + ROUNDING):
            expected = f"from 0 to {end:g}" if end < torch.inf else "of 0 and more"
            found = f"{inside.min():.4g} to {inside.max():.4g}"
            raise InputError(f"{path}: expected {component}, which is {encoding}, in values {expected}, found {found}")
        straight = straight.clamp(0, end)
        straight = srgb_to_linear(straight) if encoding == "srgb" else straight
        known = resized(torch.cat([straight * share, share], -1), down, across)
        whole = window(known, -left, -top, width, height)
        colour, covered = whole[..., :3], whole[..., 3:].clamp_min(0)
        seen = float((mask * covered[..., 0].clamp(max=1)).sum() / mask.sum().clamp_min(1e-9))
        if bool((mask > 0).any()) and seen < COVERED:
            raise InputError(f"{path}: expected the object of view {name}, found {seen:.0%} of it covered by the picture's alpha")
        colour, bare = colour / covered.clamp_min(FAINTEST), covered[..., 0] <= FAINTEST
        if bool((bare & (mask > 0)).any()) and not bool(bare.all()):
            rows, columns = distance_transform_edt(bare.numpy(), return_distances=False, return_indices=True)
            colour = colour[torch.from_numpy(rows), torch.from_numpy(columns)]
        exposure = about.exposure if component == "specular" else 1.0
        return (colour * mask[..., None] / exposure).float()


def _is_picture(path: Path) -> bool:
    return path.suffix.lower() in FORMATS and not path.name.startswith(".") and path.is_file()


def _read(path: Path) -> tuple[Tensor, Tensor | None]:
    """Colours (h, w, 3) as they are stored, and alpha (h, w, 1) where there is some. Raises InputError."""
    tensor = torch.from_numpy(read_stored(path))
    if tensor.shape[-1] == 3:
        return tensor, None
    alpha = tensor[..., 3:]
    if not (alpha.min() >= -ROUNDING and alpha.max() <= 1 + ROUNDING):
        raise InputError(f"{path}: expected alpha from 0 to 1, found {alpha.min():.4g} to {alpha.max():.4g}")
    return tensor[..., :3], alpha.clamp(0, 1)


# ---------------------------------------------------------------- what networks are shown
BACKGROUNDS = {"black": 0.0, "grey": 0.5, "white": 1.0, "transparent": None}
"""Name -> display value behind the object; None: alpha instead."""
README = """\
{count} training photographs for a network that predicts albedo, or specular shading.

images/   what the network is shown: 8-bit sRGB, {size}, the object over {background}
masks/    white where the object is, of the same size

Write what it predicts for images/VIEW.png to albedo/VIEW.png (or .exr, .npy, .jpg, ...), in any size, and specular shading,
if there is some, to specular/VIEW.png. Several samples of one view go into a folder: albedo/VIEW/0.png, albedo/VIEW/1.png.
Then say how its colours are stored: encoding srgb or linear; alpha straight, or premultiplied where edges fade to black.

  ia-bench export {scene} --for prior {out}
  (your network: {out}/images -> {out}/albedo)
  ia-bench run {settings} prior=files {path} prior.options.encoding=srgb prior.options.alpha=straight

Compare with: ia-bench run {settings} prior=none
The scene and its capture have to be the same in both. {about} says which part of a view each photograph shows, and
how bright; encoding and alpha may stand there, too, instead of in the command.
"""


def write_photographs(folder: Path, views: Sequence[View], *, size: int | None, background: str, crop: bool) -> None:
    """Write images/VIEW.png, masks/VIEW.png and predictions.json below ``folder``.

    Photographs are exposed one by one as the project's own priors see them. ``size``: side in pixels of the square that each is
    resized into; None keeps its own pixels. ``crop``: the square is that around the object and not that around the photograph.
    Raises InputError for two views of one name.
    """
    expect_distinct("ia-bench export: expected training views of different names", [view.name for view in views])
    shown = {}
    for view in views:
        image, mask = torch.from_numpy(view.image), torch.from_numpy(view.mask)
        (height, width), longest = mask.shape, max(mask.shape)
        square = Frame((height - longest) // 2, (width - longest) // 2, longest, size or longest)
        frame = Frame.around(mask, size) if crop else square if size else None
        whole = torch.cat([image, mask[..., None]], -1)
        cut = (whole if frame is None else frame.cut(whole)).clamp_min(0).numpy()
        coverage, factor = cut[..., 3].clip(0, 1), float(exposure(image[None], mask[None]))
        colour, behind = display(cut[..., :3], coverage, factor), BACKGROUNDS[background]
        if behind is None:
            colour = np.dstack([colour, coverage])
        else:
            colour = colour * coverage[..., None] + behind * (1 - coverage[..., None])
        for kind, values in (("images", colour), ("masks", coverage)):
            path = folder / kind / f"{view.name}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(np.round(255 * values).astype(np.uint8)).save(path)
        shown[view.name] = {"size": [width, height], "exposure": factor}
        if frame is not None:
            shown[view.name]["box"] = [frame.left, frame.top, frame.length, frame.length]
    unsaid = {"encoding": None, "alpha": None}
    (folder / ABOUT).write_text(json.dumps({"albedo": unsaid, "specular": unsaid, "views": shown}, indent=1))
