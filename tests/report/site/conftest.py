"""A page, and a real browser for it (tests/conftest.py)."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ia_bench.cli.report import main
from ia_bench.scenes.exr import write_exr
from ia_bench.scenes.scene import Scene

GREY_ALBEDO = 0.25  # of the row "grey", everywhere
PAGE_ROWS = {"ceiling": 40.0, "constant": 10.0, "none": 20.0, "grey": 24.0}  # PSNR of seed 0 on hat, in dB


@pytest.fixture
def open_page(browser: Any) -> Iterator[Callable[[Path], Any]]:
    """A function that opens a folder's page, 1280 pixels wide; whatever goes wrong in it or leaves its folder fails the test."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    context.set_default_timeout(1_200_000)  # of a busy machine
    wrong: list[str] = []

    def open_(folder: Path) -> Any:
        opened = context.new_page()
        opened.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
        opened.on("pageerror", lambda error: wrong.append(str(error)))
        here = (folder.as_uri(), "data:", "blob:")
        opened.on("request", lambda request: None if request.url.startswith(here) else wrong.append(request.url))
        opened.goto((folder / "index.html").as_uri())
        return opened

    yield open_
    context.close()
    assert wrong == []


def curve(seed: int) -> str:
    """Relighting rises from 10 to 20 dB, which it reaches after 9 s, or 10 s of the second seed."""
    points = ((step, 10 + step / 9 * 5, 10 + step / 9 * 10, 0.2 / (1 + step)) for step in (1, 3, 9))
    return "".join(f"final,{step},{step + seed},{albedo},12,13,{relit},{error}\n" for step, albedo, relit, error in points)


@pytest.fixture(scope="session")
def page_folder(
    write_run_below: Callable[..., Path],
    put_on_scene: Callable[..., None],
    keep_pictures: Callable[..., None],
    tmp_path_factory: pytest.TempPathFactory,
    tiny: Scene,
    tiny_folder: Path,
) -> Path:
    """Four rows on two scenes; two rows have textures on the scene ``tiny``: the truth, and one grey."""
    root = tmp_path_factory.mktemp("browser")
    write, truth = partial(write_run_below, root), tiny.truth
    textures = {"ceiling": truth.albedo, "grey": np.full_like(truth.albedo, GREY_ALBEDO)}
    for row, psnr in PAGE_ROWS.items():
        for seed in (0, 1):
            bound = row in ("ceiling", "constant")
            points = f"final,0,0,{psnr},{psnr},{psnr},{psnr},0.01\n" if bound else curve(seed)
            of = {"mean_rgb": [1.0] * 3}
            description = {"protocol_description": {"lpips": {"net": "alex"}, "alignment": "mean_rgb"}, "albedo_scales": of}
            files = {f"{name}.exr": row + name for name in ("albedo", "roughness", "light")}
            for name, better in (("hat", 0.0), ("tiny", 2.0)):
                run = write(row, name, seed, psnr=psnr + better + seed, curve=points, sees_truth=bound, files=files, **description)
                if row in textures and name == "tiny":
                    write_exr(run / "albedo.exr", textures[row], half=False)
                    write_exr(run / "roughness.exr", truth.roughness, half=False)
                    write_exr(run / "light.exr", truth.lights["train"], half=False)
                    put_on_scene(run, tiny_folder)
    keep_pictures(*(root / "runs" / f"{row}-tiny-0" for row in textures))
    assert main([str(root / "runs"), "--out", str(root / "out"), "--reference", "none"]) == 0
    return root / "out" / "page"


@pytest.fixture
def page(open_page: Callable[[Path], Any], page_folder: Path) -> Any:
    return open_page(page_folder)
