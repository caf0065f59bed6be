"""The command that checks a prior, and the stack of images that it shows one."""

from __future__ import annotations

import pytest
import torch
from broken_priors import Lenient, Sound

from ia_bench.checks.stack import painted_ball
from ia_bench.cli.check import main


def test_painted_ball_is_what_it_says() -> None:
    stack = painted_ball(37, 31, 3)
    images, masks = stack.images, stack.masks
    assert images.shape == (3, 37, 31, 3)
    assert images.dtype == masks.dtype == torch.float32
    assert 0.3 < float((masks > 0.5).float().mean()) < 0.9
    assert set(torch.unique(masks).tolist()) <= {0, 0.25, 0.5, 0.75, 1}
    assert float(stack.truth("albedo").max()) <= 1
    assert bool((images[masks == 0] == 0).all())
    # closed form: image - specular = albedo x irradiance, so the quotient is grey
    shading = (images - stack.truth("specular"))[masks == 1] / stack.truth("albedo")[masks == 1]
    assert float((shading.amax(-1) - shading.amin(-1)).abs().max()) < 0.3
    assert not torch.equal(images[0], images[1])


def test_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    here = f"{Sound.__module__}:Sound"
    assert main([f"prior={here}", "prior.options.guidance_strength=2"]) == 0
    shown = capsys.readouterr().out
    assert shown.splitlines()[-1].endswith(" passed, 0 failed, 0 skipped")
    assert " samples: albedo, specular: finite float32 tensors on the CPU, without gradient\n" in shown
    assert main([f"prior={Lenient.__module__}:Lenient"]) == 1
    assert "a NaN pixel: expected a ValueError" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "or prior=NAME; --help lists them"),
        (["prior=orcale"], "unknown prior 'orcale'; did you mean 'oracle'?"),
        (["prior=oracle", "scene=hat"], "unknown setting of ia-bench check 'scene'"),
        (["prior=oracle", "prior.options.noise=-1"], "prior.options.noise: expected 0 or more, found -1"),
        (["prior=[", "prior.x"], "cannot read"),
    ],
)
def test_mistakes(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert err.count("\n") == 1
