"""Every extreme case; the table of them, by its command; and that a case fails where it should."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import kernel_calls
import pytest
import torch
from stability import extreme_lights as lights
from stability import extreme_materials as materials
from stability.case import Case, Measured, judge, refused
from stability.table import all_cases, main

from ia_bench.cli.stability import main as command
from ia_bench.material import brdf

CASES = tuple(all_cases())


@pytest.mark.stability
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.group}: {case.extreme}: {case.quantity}")
def test_the_answer_is_what_it_must_be(case: Case) -> None:
    assert judge(case).problem is None


def test_cases_have_names_of_their_own() -> None:
    assert len(CASES) >= 60
    assert len({(case.group, case.extreme, case.quantity) for case in CASES}) == len(CASES)
    assert {case.group for case in CASES} >= {"BRDF", "light", "rendering", "SSI", "schedule", "guidance", "scores"}


def test_the_file_says_what_the_table_says(tmp_path: Path) -> None:
    out = tmp_path / "stability.json"
    words = [sys.executable, "-m", "ia_bench.stability", "--only", "PSNR", "--out", str(out)]
    ended = subprocess.run(words, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    rows = json.loads(out.read_text())
    assert [row["extreme"] for row in rows] == [case.extreme for case in CASES if "PSNR" in case.quantity]
    assert f"{len(rows)} cases, 0 failed" in ended.stdout
    assert all(row["verdict"] == "ok" and row["finite"] for row in rows)


def test_without_a_checkout_it_says_that_it_needs_one(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("ia_bench.cli.stability.PACKAGE", tmp_path / "ia_bench")
    assert command([]) == 2
    assert "needs a checkout" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("measured", "problem"),
    [
        (Measured(0.1, 0.1), None),
        (Measured(0.3), "error above 0.2"),
        (Measured(math.nan), "error above 0.2"),
        (Measured(0.1, 0.5), "gradient error above 0.4"),
        (Measured(0.1, math.nan), "gradient error above 0.4"),
        (Measured(0.0, finite=False), "NaN or Inf"),
    ],
    ids=str,
)
def test_verdicts(measured: Measured, problem: str | None) -> None:
    assert judge(Case("", "", "", "", 0.2, lambda: measured, 0.4)).problem == problem


def test_a_case_that_raises_or_does_not_refuse_as_it_must_has_failed() -> None:
    row = judge(Case("", "", "", "", 1.0, lambda: Measured(1 / 0)))
    assert (row.problem, row.measured) == ("ZeroDivisionError: division by zero", None)
    assert refused(lambda: float("x"), ValueError, "could not convert").error == 0
    assert refused(lambda: float("x"), ValueError, "banana").error == math.inf
    assert refused(lambda: float("1"), ValueError, "").error == math.inf


def test_a_wrong_brdf_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """1 - (n.h)^2 taken literally loses the narrow lobes in float32."""

    def careless(normal: torch.Tensor, half: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
        cosine = brdf.dot(normal, half)
        return alpha**2 / (math.pi * (1 - cosine**2 + alpha**2 * cosine**2).clamp_min(1e-8) ** 2)

    monkeypatch.setattr(brdf, "ggx_ndf", careless)
    narrow = next(case for case in materials.cases() if "0.03, around" in case.extreme)
    assert judge(narrow).problem is not None


def test_a_wrong_light_sampler_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every draw lands one row too low."""
    sample = kernel_calls.sample_texel

    def low(sampler: lights.LatLongSampler, cell: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        return (sample(sampler, cell, u) + sampler.width) % (sampler.height * sampler.width)

    monkeypatch.setattr(kernel_calls, "sample_texel", low)
    shares = next(case for case in lights.cases() if case.extreme == "one texel of 1e6" and "share" in case.quantity)
    assert judge(shares).problem is not None


def test_the_command_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--only", "SSIM"]) == 0
    count = sum("SSIM" in f"{case.group} {case.extreme} {case.quantity}" for case in CASES)
    assert f"{count} cases, 0 failed" in capsys.readouterr().out
    assert main(["--only", "banana"]) == 2
    assert main(["--out", "/nowhere/at/all.json"]) == 2
    assert "/nowhere/at" in capsys.readouterr().err
    wrong = Case("arithmetic", "one", "two", "three", 0.1, lambda: Measured(0.2))
    monkeypatch.setattr("stability.table.all_cases", lambda: iter([wrong]))
    assert main([]) == 1
    assert "FAILED: error above 0.1" in capsys.readouterr().out
