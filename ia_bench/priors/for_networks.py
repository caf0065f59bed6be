"""Training photographs as networks that predict materials want them; :mod:`ia_bench.priors.files` takes the predictions back."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from ia_bench.priors.diffusion.encoding import exposure
from ia_bench.priors.diffusion.framing import Frame
from ia_bench.priors.files import ABOUT
from ia_bench.scenes.images import display
from ia_bench.scenes.scene import View

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
  ia-bench run {settings} prior=files prior.options.path={out} prior.options.encoding=srgb prior.options.alpha=straight

Compare with: ia-bench run {settings} prior=none
The scene and its capture have to be the same in both. {about} says which part of a view each photograph shows, and
how bright; encoding and alpha may stand there, too, instead of in the command.
"""


def write_photographs(folder: Path, views: Sequence[View], *, size: int | None, background: str, crop: bool) -> None:
    """Write images/VIEW.png, masks/VIEW.png and predictions.json below ``folder``.

    Photographs are exposed one by one as the project's own priors see them. ``size``: side in pixels of the square that each is
    resized into; None keeps its own pixels. ``crop``: the square is that around the object and not that around the photograph.
    """
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
