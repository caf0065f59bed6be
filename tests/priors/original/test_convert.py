"""The converter against networks whose weights have the names of the release (ldm.py): same numbers, from the right tensors."""

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from ldm import TINY, originals, save, state_of, tiny

from ia_bench.common.errors import InputError
from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench_training.convert_weights import RELEASE, convert, networks, read_checkpoint

TOLERANCE = 2e-5  # two orders of summation in float32; a wrong tensor differs by 0.1 and more


def edited(release: Path, path: Path, edit: Callable[[dict[str, Any]], object]) -> Path:
    """The tiny albedo checkpoint with something changed."""
    content = torch.load(release / "albedo" / "checkpoints" / "last.ckpt", weights_only=False)  # made by these tests
    edit(content)
    return save(content, path)


# ---- the numbers -----------------------------------------------------------------------------------------------------
@torch.no_grad()
def test_weights_are_the_averaged_ones_in_half_precision(weights: Path) -> None:
    import_torchvision()
    from diffusers import AutoencoderKL, UNet2DConditionModel
    from transformers import CLIPVisionModelWithProjection

    unet, vae, visual = tiny(1)
    for name, kind, original in (("unet", UNet2DConditionModel, unet), ("vae", AutoencoderKL, vae)):
        converted, expected = kind.from_pretrained(weights / "albedo" / name).state_dict(), original.state_dict()
        assert converted.keys() == expected.keys()
        assert [key for key, value in expected.items() if not torch.equal(converted[key], value.half().float())] == []

    images = torch.randn(2, 3, 32, 32, generator=torch.Generator().manual_seed(0))
    clip = CLIPVisionModelWithProjection.from_pretrained(weights / "albedo" / "image_encoder").float()
    expected = visual.half().float()(images)
    torch.testing.assert_close(clip(pixel_values=images).image_embeds, expected, atol=TOLERANCE, rtol=0)


def test_full_size_is_that_of_the_release() -> None:
    """At the release's size, without memory: every parameter has a tensor of its shape, and there are as many as published."""
    with torch.device("meta"):
        state = state_of(*originals(RELEASE))
    sizes = {}
    for name, (model, tensors) in networks(state, RELEASE).items():
        for key, value in model.state_dict().items():
            assert tensors[key].shape == value.shape, (name, key)
        sizes[name] = sum(value.numel() for value in model.parameters())
    # Stable Diffusion 1.5's UNet of 859 520 964, its autoencoder, and CLIP ViT-L/14.
    assert sizes == {"unet": 859_532_484, "vae": 83_653_863, "image_encoder": 303_966_208}


# ---- safety ----------------------------------------------------------------------------------------------------------
class Evil:
    """Unpickling it with an ordinary unpickler creates a file."""

    def __init__(self, call: Callable[..., object], argument: object) -> None:
        self.call, self.argument = call, argument

    def __reduce__(self) -> tuple[object, ...]:
        return (self.call, (self.argument,))


def test_malicious_pickle_is_refused_without_executing(release: Path, tmp_path: Path) -> None:
    harm = tmp_path / "harm"
    by_eval, by_path = Evil(eval, f"open({str(harm)!r}, 'w')"), Evil(Path.touch, harm)
    for number, (place, evil) in enumerate([("callbacks", by_eval), ("state_dict", by_eval), ("hyper_parameters", by_path)]):
        path = edited(release, tmp_path / f"{number}.ckpt", lambda content, p=place, e=evil: content.update({p: {"x": e}}))
        with pytest.raises(InputError, match=rf"{number}.ckpt: expected .* tensors and numbers, found: .*(eval|getattr|Path)"):
            read_checkpoint(path)
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
        assert len(read_checkpoint(path)["betas"]) == 1000


BIAS = "model_ema.diffusion_modelout2bias"


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda c: c.pop("state_dict"), "expected a Lightning checkpoint of tensors and numbers, found: 'state_dict'"),
        (
            lambda c: c["state_dict"].pop("model_ema.diffusion_modelout2weight"),
            r"unet: expected a tensor of shape \(4, 32, 3, 3\) for conv_out.weight, found none",
        ),
        (
            lambda c: c["state_dict"].update({"cond_stage_model.model.visual.ln_pre.bias": torch.zeros(33)}),
            r"image_encoder: expected a tensor of shape \(128,\) for vision_model.pre_layrnorm.bias, found shape \(33,\)",
        ),
        (lambda c: c["state_dict"][BIAS].fill_(7e4), r"unet: conv_out.bias: expected numbers below 65504 \(half precision\)"),
        (lambda c: c["state_dict"].update(betas=torch.linspace(1e-4, 0.02, 1000)), "betas: expected those of the release"),
    ],
)
def test_errors_name_file_and_tensor(edit: Callable[[dict], object], message: str, release: Path, tmp_path: Path) -> None:
    path = edited(release, tmp_path / "broken.ckpt", edit)
    with pytest.raises(InputError, match=f"broken.ckpt: {message}"):
        convert(path, tmp_path / "out", TINY)
