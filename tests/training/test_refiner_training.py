"""The refiner learns what is wrong with fits, resumes to the same weights, and its commands run."""

import json
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor

from ia_bench.common.arguments import read_arguments
from ia_bench.common.errors import InputError
from ia_bench.common.progress import Progress
from ia_bench.priors.refiner import load_refiner
from ia_bench_training.fit_data import main as make
from ia_bench_training.fit_files import CHANNELS, FitInfo, fit_path, fit_paths, load_fit, write_fit
from ia_bench_training.refiner import RefinerSettings, Views, _recoloured, train_refiner
from ia_bench_training.train_refiner import main

SIZE = 16
SMALL = ["network.channels=[8,16]", "batch=8", "warmup=5", "threads=1"]


def made_up(seed: int, index: int) -> dict[str, Tensor]:
    """Views whose albedo and roughness are right but for what the normal does to them, which the network sees."""
    generator = torch.Generator().manual_seed(1000 * seed + index)
    truth = torch.rand(4, SIZE // 4, SIZE // 4, 3, generator=generator).repeat_interleave(4, 1).repeat_interleave(4, 2) * 0.5 + 0.2
    normal = torch.nn.functional.normalize(torch.randn(4, SIZE, SIZE, 3, generator=generator), dim=-1)
    wrong = truth * torch.exp(0.4 * normal[..., :1])
    one, dim = torch.ones(4, SIZE, SIZE, 1), 0.01 * torch.ones(4, SIZE, SIZE, 3)
    return {
        "image": torch.cat([truth * 0.5, one], -1), "albedo": wrong, "roughness": 0.5 + 0.2 * normal[..., 1:2],
        "radiance": truth * 0.5, "specular": dim, "evidence": dim[..., :2], "normal": normal, "visibility": one,
        "view_count": 3 * one, "true_albedo": truth, "true_roughness": 0.5 * one,
    }  # fmt: skip


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("fits")
    for name, seed, count in (("data", 0, 12), ("validation", 1, 3)):
        (root / name).mkdir()
        for index in range(count):
            photographs = 8 if index % 2 else 12
            write_fit(fit_path(root / name, seed, index), made_up(seed, index), FitInfo(seed, photographs))
    return root


def command(folders: Path, out: Path, *more: str) -> list[str]:
    return [f"data={folders / 'data'}", f"validation={folders / 'validation'}", f"out={out}", *SMALL, *more]


def test_what_is_wrong_is_learned(folders: Path, tmp_path: Path) -> None:
    assert main(command(folders, tmp_path / "run", "steps=150", "validate_steps=150", "muon_rate=0.01")) == 0
    (line,) = (tmp_path / "run" / "validation.jsonl").read_text().splitlines()
    figures = json.loads(line)
    assert figures["step"] == 150
    for kind in ("few", "many"):
        assert figures[f"{kind}_refined"] > figures[f"{kind}_fit"] + 4
        assert figures[f"{kind}_refined_roughness"] < 0.8 * figures[f"{kind}_fit_roughness"]
    load_refiner(tmp_path / "run" / "weights")


def test_a_run_that_was_stopped_goes_on_to_the_same_weights(folders: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, stopped = (
        read_arguments(RefinerSettings, command(folders, tmp_path / name, "steps=6", "validate_steps=3"))
        for name in ("whole", "stopped")
    )
    with Progress() as progress:
        train_refiner(whole, progress)
        with monkeypatch.context() as patch:
            patch.setattr("ia_bench_training.refiner.save_refiner", interrupt)
            with pytest.raises(KeyboardInterrupt):
                train_refiner(stopped, progress)
        assert torch.load(stopped.out / "state.pt", weights_only=True)["step"] == 3
        train_refiner(stopped, progress)
    a, b = (load_refiner(settings.out / "weights").state_dict() for settings in (whole, stopped))
    assert all(torch.equal(a[name], b[name]) for name in a)


def interrupt(*_: object) -> None:
    raise KeyboardInterrupt


def test_views_are_recoloured_and_turned_together(folders: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The error of an untouched albedo does not depend on the order of the colours, nor on the side."""
    monkeypatch.setattr("ia_bench_training.refiner.ZOOM", 1.0)
    views = Views(folders / "data")
    index = torch.arange(8)
    plain = views.batch(index)
    turned = views.batch(index, torch.Generator().manual_seed(3))
    assert not torch.equal(plain.albedo, turned.albedo)
    nothing = torch.zeros(8, 4, SIZE, SIZE)
    torch.testing.assert_close(turned.errors(nothing), plain.errors(nothing), rtol=1e-4, atol=1e-7)


def test_another_light_tints_all_that_it_lights_and_another_cast_the_albedo_alone() -> None:
    """Renders keep their ratios to the photograph, whose coverage stays; what scales the albedo to the truth undoes the cast."""
    views = {name: torch.rand(5, SIZE, SIZE, channels) + 0.1 for name, channels in CHANNELS.items()}
    scale = torch.rand(5, 3) + 0.5
    seen, scaled = _recoloured(views, scale, torch.Generator().manual_seed(0))
    tint = seen["image"][..., :3] / views["image"][..., :3]
    assert float(tint.std()) > 0.1
    for name in ("radiance", "specular"):
        torch.testing.assert_close(seen[name], tint * views[name])
    torch.testing.assert_close(seen["albedo"] * scaled[:, None, None], views["albedo"] * scale[:, None, None])
    assert not torch.equal(seen["albedo"], views["albedo"])
    assert torch.equal(seen["image"][..., 3], views["image"][..., 3])
    assert all(torch.equal(seen[name], views[name]) for name in CHANNELS if name not in ("image", "radiance", "specular", "albedo"))


def test_fits_come_back_and_damage_is_named(folders: Path, tmp_path: Path) -> None:
    path = fit_paths(folders / "data")[1]
    tensors, info = load_fit(path)
    assert info == FitInfo(0, 8)
    for name, channels in CHANNELS.items():
        assert tensors[name].shape == (4, SIZE, SIZE, channels)
        torch.testing.assert_close(tensors[name].float(), made_up(0, 1)[name], rtol=1e-3, atol=1e-3)
    damaged = tmp_path / path.name
    damaged.write_bytes(path.read_bytes()[:500])
    with pytest.raises(InputError, match="found no file that can be read"):
        load_fit(damaged)
    write_fit(damaged, tensors, FitInfo(0, 8, version=99))
    with pytest.raises(InputError, match="expected a fit of a procedural scene of version 2, found 99"):
        load_fit(damaged)
    metadata = {"seed": "0", "index": "1", "photographs": "8", "clipped": "1", "version": "2"}  # as older programs wrote it
    save_file(tensors, damaged, metadata=metadata)
    assert load_fit(damaged)[1] == FitInfo(0, 8)
    with pytest.raises(InputError, match=r"expected fit_\*\.safetensors .*, found none"):
        fit_paths(tmp_path / "nowhere")


@pytest.mark.slow
def test_fits_of_procedural_scenes_are_made_and_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command makes what is missing alone, and the same fit each time (to rounding)."""
    line = [f"out={tmp_path}", "seed=3", "size=16", "workers=2"]
    assert make([*line, "fits=2"]) == 0
    first, second = fit_paths(tmp_path)
    tensors, info = load_fit(second)
    changed = first.stat().st_mtime_ns
    second.unlink()
    assert make([*line, "fits=2"]) == 0
    assert first.stat().st_mtime_ns == changed
    again, same = load_fit(second)
    assert same == info
    for name in ("true_albedo", "true_roughness"):
        torch.testing.assert_close(again[name], tensors[name])
    torch.testing.assert_close(again["albedo"].float(), tensors["albedo"].float(), rtol=0, atol=0.05)
    inside = tensors["image"][..., 3] > 0.9
    assert float(tensors["true_albedo"][inside].float().min()) >= 0.019
    assert float(tensors["true_roughness"][inside].float().min()) >= 0.04
    assert int(tensors["view_count"].max()) <= info.photographs
    assert make([line[0], "seed=3", "size=24", "fits=2"]) == 2
    assert f"{first}: expected a fit in photographs of size=24 pixels a side, found 16" in capsys.readouterr().err
