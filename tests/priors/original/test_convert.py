"""The converter against latent diffusion written out in plain torch (ldm.py): same numbers, from the right tensors."""

from __future__ import annotations

import json
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from ldm import LatentDiffusion, save
from torch import Tensor

from ia_bench.common.arguments import read_arguments
from ia_bench.common.errors import InputError
from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench.priors.original import layout, names
from ia_bench.priors.original.checkpoint import Checkpoint, open_checkpoint, sha256
from ia_bench.priors.original.convert import Request, convert, half_precision
from ia_bench_training.convert_weights import main

TOLERANCE = 2e-5  # two orders of summation in float32; a wrong tensor differs by 0.1 and more


def edited(release: Path, path: Path, edit: Callable[[dict[str, Any]], object]) -> Path:
    """The tiny albedo checkpoint with something changed."""
    content = torch.load(release / "albedo" / "checkpoints" / "last.ckpt", weights_only=False)  # made by these tests
    edit(content)
    return save(content, path)


def inputs(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


# ---- the numbers -----------------------------------------------------------------------------------------------------


@torch.no_grad()
@pytest.mark.parametrize(("component", "seed"), [("albedo", 1), ("specular", 2)])
def test_outputs_equal_those_of_the_averaged_weights(weights: Path, component: str, seed: int) -> None:
    import_torchvision()
    from diffusers import AutoencoderKL, UNet2DConditionModel
    from transformers import CLIPVisionModelWithProjection

    original = LatentDiffusion.tiny(seed)
    expected, folder = original.reference(), weights / component
    unet = UNet2DConditionModel.from_pretrained(folder / "unet").float()
    latents, steps, token = inputs(2, 8, 8, 8), torch.tensor([3, 970]), inputs(2, 1, 16, seed=1)
    converted = unet(latents, steps, token).sample
    torch.testing.assert_close(converted, expected.model.diffusion_model(latents, steps, token), atol=TOLERANCE, rtol=0)
    raw = original.model.diffusion_model(latents, steps, token)
    assert float((converted - raw).abs().mean()) > 0.1  # the raw weights are another network

    vae = AutoencoderKL.from_pretrained(folder / "vae").float()
    images, latents = inputs(2, 3, 32, 32), inputs(2, 4, 8, 8)
    mode = vae.encode(images).latent_dist.mode()
    torch.testing.assert_close(mode, expected.first_stage_model.mode(images), atol=TOLERANCE, rtol=0)
    decoded = vae.decode(latents).sample
    torch.testing.assert_close(decoded, expected.first_stage_model.decode(latents), atol=TOLERANCE, rtol=0)

    clip = CLIPVisionModelWithProjection.from_pretrained(folder / "image_encoder").float()
    embedding = clip(pixel_values=images).image_embeds
    torch.testing.assert_close(embedding, expected.cond_stage_model.model.visual(images), atol=TOLERANCE, rtol=0)


def test_full_size_layout_is_stable_diffusion_with_eight_input_channels() -> None:
    """At the release's size, on meta tensors: the known configuration, and every tensor but the text encoder's used once."""
    import_torchvision()
    from diffusers import AutoencoderKL, UNet2DConditionModel
    from transformers import CLIPVisionConfig, CLIPVisionModelWithProjection

    state = LatentDiffusion.full_size().state_dict()
    raw = [key for key in state if key.startswith(names.UNET)]
    state |= {names.UNET_EMA + key.removeprefix(names.UNET).replace(".", ""): state[key] for key in raw}
    checkpoint = Checkpoint(Path("last.ckpt"), state)
    unet, vae, clip = layout.unet_config(checkpoint, 32), layout.vae_config(checkpoint, 256), layout.clip_config(checkpoint)
    assert unet["block_out_channels"] == [320, 640, 1280, 1280]
    assert unet["down_block_types"] == ["CrossAttnDownBlock2D"] * 3 + ["DownBlock2D"]
    assert (unet["in_channels"], unet["out_channels"], unet["layers_per_block"], unet["cross_attention_dim"]) == (8, 4, 2, 768)
    assert (vae["block_out_channels"], vae["layers_per_block"], vae["latent_channels"]) == ([128, 256, 512, 512], 2, 4)
    assert (clip["hidden_size"], clip["num_attention_heads"], clip["num_hidden_layers"]) == (1024, 16, 24)
    assert (clip["image_size"], clip["patch_size"], clip["projection_dim"]) == (224, 14, 768)
    used: list[str] = []
    with torch.device("meta"):
        models = (
            (UNet2DConditionModel(**unet), names.unet_sources(checkpoint, unet).__getitem__),
            (AutoencoderKL(**vae), names.vae_sources(checkpoint, vae).__getitem__),
            (CLIPVisionModelWithProjection(CLIPVisionConfig(**clip)), names.clip_source),
        )
    for model, source in models:
        for name, value in model.state_dict().items():
            key, take = source(name)
            assert take(state[key]).shape == value.shape, (name, key)
            used.append(key)
    assert sum(value.numel() for value in models[0][0].state_dict().values()) == 859_532_484  # SD 1.5: 859 520 964
    stacked = {key for key in used if "in_proj_" in key}  # queries, keys and values are stacked in one tensor
    assert {key: used.count(key) for key in set(used)} == {key: 3 if key in stacked else 1 for key in set(state) - {"betas", *raw}}


def test_files_are_safetensors_in_half_precision_with_their_origin(release: Path, weights: Path) -> None:
    from safetensors.torch import load_file

    files = {path.relative_to(weights).as_posix() for path in weights.rglob("*") if path.is_file()}
    parts = {"unet/config.json", "unet/diffusion_pytorch_model.safetensors", "vae/config.json",
             "vae/diffusion_pytorch_model.safetensors", "image_encoder/config.json", "image_encoder/model.safetensors",
             "scheduler/scheduler_config.json", "source.json"}  # fmt: skip
    assert files == {f"{component}/{part}" for component in ("albedo", "specular") for part in parts}
    tensors = load_file(weights / "albedo" / "unet" / "diffusion_pytorch_model.safetensors")
    assert {tensor.dtype for tensor in tensors.values()} == {torch.float16}
    record = json.loads((weights / "albedo" / "source.json").read_text())
    assert record["sha256"] == sha256(release / "albedo" / "checkpoints" / "last.ckpt")
    assert record["verified"] is False


def test_second_conversion_does_nothing_and_another_file_is_refused(
    release: Path, weights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    checkpoint = release / "albedo" / "checkpoints" / "last.ckpt"
    before = {path: path.stat().st_mtime_ns for path in weights.rglob("*")}
    assert main([f"albedo={checkpoint}", f"out={weights}", "resolution=32"]) == 0
    assert "converted before, nothing to do" in capsys.readouterr().out
    assert main([f"albedo={checkpoint}", f"out={weights}", "resolution=64"]) == 2
    assert "albedo is there already, for resolution=32" in capsys.readouterr().err
    assert main([f"albedo={release / 'specular' / 'checkpoints' / 'last.ckpt'}", f"out={weights}"]) == 2
    assert "albedo is there already, converted from another file" in capsys.readouterr().err
    assert before == {path: path.stat().st_mtime_ns for path in weights.rglob("*")}


# ---- safety ----------------------------------------------------------------------------------------------------------


class Malicious:
    """Unpickling it with an ordinary unpickler creates a file."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (self.target,))


def evil_eval(target: Path) -> object:
    class Evil:
        def __reduce__(self) -> tuple[object, ...]:
            return (eval, (f"open({str(target)!r}, 'w')",))

    return Evil()


def test_malicious_pickle_is_refused_without_executing(release: Path, tmp_path: Path) -> None:
    harm = tmp_path / "harm"
    for number, (place, name) in enumerate(
        [("callbacks", "builtins.eval"), ("state_dict", "builtins.eval"), ("hyper_parameters", "pathlib.Path.touch")]
    ):
        evil = Malicious(harm) if "pathlib" in name else evil_eval(harm)
        path = edited(release, tmp_path / f"{number}.ckpt", lambda content, p=place, e=evil: content.update({p: {"x": e}}))
        with pytest.raises(InputError, match=rf"{number}.ckpt: refused: .* a pickle that asks for .*(eval|getattr|Path)"):
            open_checkpoint(path)
        assert not harm.exists()
    torch.load(tmp_path / "0.ckpt", weights_only=False)  # the file does what it is refused for
    assert harm.exists()


def test_numpy_scalars_of_either_spelling_are_stood_in_for(release: Path, tmp_path: Path) -> None:
    """numpy 1 wrote `numpy.core`, numpy 2 writes `numpy._core`; the release is of the former."""
    new = release / "albedo" / "checkpoints" / "last.ckpt"
    old = tmp_path / "old.ckpt"
    with zipfile.ZipFile(new) as source, zipfile.ZipFile(old, "w") as target:
        for item in source.infolist():
            data = source.read(item)
            if item.filename.endswith("data.pkl"):
                assert b"cnumpy._core.multiarray\nscalar" in data
                data = data.replace(b"cnumpy._core.multiarray", b"cnumpy.core.multiarray")
            target.writestr(item, data)
    for path in (new, old):
        assert open_checkpoint(path).size("betas", 0) == 1000


def test_wrong_hash_stops_before_the_file_is_opened(release: Path, tmp_path: Path) -> None:
    checkpoint = release / "albedo" / "checkpoints" / "last.ckpt"
    request = read_arguments(Request, [f"albedo={checkpoint}", f"out={tmp_path / 'out'}", f"albedo_sha256={'0' * 64}"])
    with pytest.raises(InputError, match=rf"last.ckpt: expected SHA-256 0{{64}}, found {sha256(checkpoint)}"):
        convert(request, lambda text: None)
    assert not (tmp_path / "out").exists()


def test_cut_off_file_and_other_kinds(release: Path, tmp_path: Path) -> None:
    checkpoint = release / "albedo" / "checkpoints" / "last.ckpt"
    cut = tmp_path / "cut.ckpt"
    cut.write_bytes(checkpoint.read_bytes()[:-1000])
    with pytest.raises(InputError, match=r"cut.ckpt: expected a whole checkpoint .* the file is cut off"):
        open_checkpoint(cut)
    legacy = tmp_path / "legacy.ckpt"
    legacy.write_bytes(pickle.dumps({"state_dict": {}}))
    with pytest.raises(InputError, match="legacy.ckpt: expected a whole checkpoint"):
        open_checkpoint(legacy)
    archive = tmp_path / "archive.ckpt"
    with zipfile.ZipFile(archive, "w") as target:
        target.writestr("something/else.txt", "no checkpoint")
    with pytest.raises(InputError, match="archive.ckpt: cannot be read as a checkpoint"):
        open_checkpoint(archive)
    with pytest.raises(InputError, match="nowhere.ckpt: no such file"):
        open_checkpoint(tmp_path / "nowhere.ckpt")


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda c: c.pop("state_dict"), r"expected a Lightning checkpoint with the key state_dict, found epoch, global_step"),
        (lambda c: c["state_dict"].update(note="x"), r"state_dict.note: expected a tensor, found str"),
        (
            lambda c: c["state_dict"].pop("model_ema.diffusion_modelout2weight"),
            r"expected a tensor model_ema.diffusion_modelout2weight, found none of that name among",
        ),
        (
            lambda c: c["state_dict"].pop("first_stage_model.decoder.mid.attn_1.q.weight"),
            r"expected a tensor for decoder.mid_block.attentions.0.to_q.weight, found none",
        ),
        (
            lambda c: c["state_dict"].update({"model_ema.diffusion_modelout0bias": torch.zeros(33)}),
            r"model_ema.diffusion_modelout0bias: expected shape \(32,\) for conv_norm_out.bias, found \(33,\)",
        ),
        (
            lambda c: c["state_dict"].update({"cond_stage_model.model.visual.proj": torch.zeros(())}),
            r"cond_stage_model.model.visual.proj: expected at least 2 axes, found shape \(\)",
        ),
        (lambda c: c["state_dict"].update(betas=torch.linspace(1e-4, 0.02, 1000)), r"betas: expected 1000 values from 0.00085"),
        (
            lambda c: [c["state_dict"].pop(key) for key in list(c["state_dict"]) if key.startswith("first_stage_model")],
            r"expected tensors first_stage_model.encoder.down.0..., found none",
        ),
    ],
)  # fmt: skip
def test_errors_name_file_and_key(
    edit: Callable[[dict], object], message: str, release: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = edited(release, tmp_path / "broken.ckpt", edit)
    with pytest.raises(InputError, match=f"broken.ckpt: {message}"):
        convert(read_arguments(Request, [f"albedo={path}", f"out={tmp_path / 'out'}", "resolution=32"]), lambda text: None)
    assert not (tmp_path / "out" / "albedo" / "source.json").exists()  # nobody takes it for a whole conversion


def test_number_beyond_half_precision_is_an_error() -> None:
    checkpoint = Checkpoint(Path("last.ckpt"), {"a": torch.tensor([1.0, 7e4]), "b": torch.tensor([torch.nan])})
    for key in ("a", "b"):
        with pytest.raises(InputError, match=f"last.ckpt: {key}: expected numbers below 65504"):
            half_precision(checkpoint, {"x": tuple(checkpoint.tensor(key).shape)}, {"x": names.Source(key)})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["out=x"], "expected albedo=CKPT or specular=CKPT or both, found neither"),
        (["albedo=a.ckpt"], "out: expected a value"),
        (["albdo=a.ckpt", "out=x"], "unknown setting 'albdo'; did you mean 'albedo'?"),
        (["albedo", "out=x"], "albedo: expected albedo=VALUE, found 'albedo'"),
        (["albedo=a.ckpt", "out=x", "resolution=-1"], "resolution: expected 1 or more, found -1"),
        (["albedo=no.ckpt", "out=x"], "albedo=no.ckpt: no such file"),
    ],
)
def test_mistakes_on_the_command_line(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert message in err
    assert (out, err.count("\n")) == ("", 1)
