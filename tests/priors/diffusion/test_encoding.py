import pytest
import torch

from ia_bench.priors.diffusion.encoding import (
    EXPOSED_VALUE,
    decode,
    encode,
    encode_image,
    exposure,
)


@pytest.fixture
def picture():
    generator = torch.Generator().manual_seed(0)
    masks = (torch.rand(3, 8, 8, generator=generator) * 1.5 - 0.25).clamp(0, 1)
    colours = torch.rand(3, 8, 8, 3, generator=generator)
    return colours * masks[..., None], masks


def test_exposure_brings_the_quantile_of_the_foreground_to_its_value(picture):
    images, masks = picture
    exposed = images * exposure(images, masks)[:, None, None, None]
    for image, mask in zip(exposed, masks, strict=True):
        brightest = image.amax(-1)[mask > 0.5]
        share = (brightest <= EXPOSED_VALUE * 1.0001).float().mean()
        assert 0.85 < share < 0.97


def test_exposure_divides_the_scale_of_an_image_out(picture):
    images, masks = picture
    torch.testing.assert_close(exposure(1e6 * images, masks) * 1e6, exposure(images, masks))
    seen = encode_image(images, masks, exposure(images, masks))
    again = encode_image(1e-3 * images, masks, exposure(1e-3 * images, masks))
    torch.testing.assert_close(again, seen, atol=1e-5, rtol=0)


@pytest.mark.parametrize("coverage", [0.6, 0.3, 0.01])
def test_glass_is_exposed_as_what_fills_its_pixels(coverage):
    colours = torch.rand(2, 8, 8, 3, generator=torch.Generator().manual_seed(0))
    masks = torch.ones(2, 8, 8)
    torch.testing.assert_close(exposure(colours * coverage, masks * coverage), exposure(colours, masks))


def test_albedo_returns_from_its_encoding(picture):
    albedo, masks = picture
    encoded = encode("albedo", albedo, masks, torch.full((3,), 0.25))
    assert encoded.abs().max() <= 1
    assert bool((encoded.movedim(1, -1)[masks == 0] == 0).all())
    torch.testing.assert_close(decode("albedo", encoded, masks, torch.full((3,), 0.5)), albedo, atol=1e-5, rtol=0)


def test_specular_returns_up_to_the_white_of_the_image(picture):
    colours, masks = picture
    specular, factor = colours / 0.25, torch.full((3,), 0.25)
    encoded = encode("specular", specular, masks, factor)
    torch.testing.assert_close(decode("specular", encoded, masks, factor), specular, atol=1e-4, rtol=1e-4)
    beyond = decode("specular", encode("specular", 100 * specular, masks, factor), masks, factor)
    assert beyond.max() <= 1 / 0.25 * 1.0001
