"""Frames and the way back: cut and paste are inverse, and predictions at the image's own size, against what is known."""

import pytest
import torch

from ia_bench.priors.diffusion.encoding import (
    EXPOSED_VALUE,
    Frame,
    decode,
    encode,
    encode_image,
    enlarge,
    enlarge_by_difference,
    enlarge_by_gain,
    exposure,
)
from ia_bench.scenes.color import tone_map

SIZE = 100


@pytest.fixture
def frame() -> Frame:
    mask = torch.zeros(SIZE, SIZE)
    mask[2:-2, 2:-2] = 1
    found = Frame.around(mask, 32)
    assert found.length > 3 * found.side
    return found


def texture() -> torch.Tensor:
    """Stripes of two pixels, which a reduced image cannot hold, with a colour that changes slowly."""
    rows, columns = torch.meshgrid(torch.arange(SIZE), torch.arange(SIZE), indexing="ij")
    stripes = 0.3 + 0.3 * ((rows // 2) % 2)
    return torch.stack([stripes, stripes * columns / SIZE, 0.5 * stripes], -1)


def shading() -> torch.Tensor:
    rows, columns = torch.meshgrid(torch.arange(SIZE), torch.arange(SIZE), indexing="ij")
    return (0.6 + 0.4 * torch.cos(rows / 30 + columns / 50))[..., None]


def everywhere(frame: Frame) -> torch.Tensor:
    return (frame.cut(torch.ones(SIZE, SIZE, 1))[..., 0] > 0.99).float()


def error(found: torch.Tensor, truth: torch.Tensor) -> float:
    inner = slice(8, -8)  # away from the border of the picture, which a reduced image mixes with nothing
    return float((found - truth)[inner, inner].square().mean().sqrt())


def test_texture_of_the_image_outlives_the_reduction(frame: Frame) -> None:
    albedo, image = texture(), texture() * shading()
    reduced, seen, known = frame.cut(albedo), frame.cut(image), everywhere(frame)
    plain = error(enlarge(frame, reduced, known, albedo.shape[:2]), albedo)
    by_gain = error(enlarge_by_gain(frame, reduced, seen, image, known), albedo)
    assert plain > 0.1
    assert by_gain < 0.02


def test_a_smooth_change_of_a_render_is_carried_over(frame: Frame) -> None:
    render, changed = texture(), texture() - 0.1 * shading()
    found = enlarge_by_difference(frame, frame.cut(changed), frame.cut(render), render, everywhere(frame))
    assert error(found, changed.clamp_min(0)) < 0.002


# ----- cut and paste -----------------------------------------------------------------------------------------------------------
def disc(height, width, row, column, radius):
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    return ((rows - row) ** 2 + (columns - column) ** 2 <= radius**2).float()


def test_cut_and_paste_are_inverse_and_resizing_keeps_a_constant_colour_up_to_the_edge():
    mask = disc(40, 50, 18, 30, 9)
    values = torch.rand(40, 50, 3, generator=torch.Generator().manual_seed(0))
    frame = Frame.around(mask, None)
    assert frame.side % 8 == 0
    again = frame.paste(frame.cut(values), torch.ones(frame.side, frame.side), mask)
    torch.testing.assert_close(again, values * mask[..., None])
    mask = disc(100, 100, 50, 50, 37)
    frame = Frame.around(mask, 32)
    weight = (frame.cut(mask[..., None])[..., 0] > 0).float()
    colour = torch.tensor([0.2, 0.5, 0.9])
    again = frame.paste(colour.expand(32, 32, 3) * weight[..., None] + 7 * (1 - weight[..., None]), weight, mask)
    torch.testing.assert_close(again, colour * mask[..., None], atol=1e-5, rtol=0)


@pytest.fixture
def picture():
    generator = torch.Generator().manual_seed(0)
    masks = (torch.rand(3, 8, 8, generator=generator) * 1.5 - 0.25).clamp(0, 1)
    colours = torch.rand(3, 8, 8, 3, generator=generator)
    return colours * masks[..., None], masks


def test_exposure_brings_the_quantile_of_the_foreground_to_its_value_at_any_scale(picture):
    images, masks = picture
    exposed = images * exposure(images, masks)[:, None, None, None]
    for image, mask in zip(exposed, masks, strict=True):
        brightest = image.amax(-1)[mask > 0.5]
        share = (brightest <= EXPOSED_VALUE * 1.0001).float().mean()
        assert 0.85 < share < 0.97
    for factor in (1e6, 1e-10):
        torch.testing.assert_close(exposure(factor * images, masks) * factor, exposure(images, masks))
    seen = encode_image(images, masks, exposure(images, masks))
    again = encode_image(1e-3 * images, masks, exposure(1e-3 * images, masks))
    torch.testing.assert_close(again, seen, atol=1e-5, rtol=0)


def test_exposure_of_nothing_is_one_and_of_one_bright_pixel_what_it_must_be():
    one = torch.zeros(8, 8)
    one[3, 4] = 1
    images = torch.stack([torch.ones(8, 8, 3), torch.zeros(8, 8, 3), 1e6 * one[..., None].expand(8, 8, 3)])
    factors = exposure(images, torch.stack([torch.zeros(8, 8), torch.ones(8, 8), one]))
    assert factors[:2].tolist() == [1, 1]
    assert float(factors[2]) == pytest.approx(EXPOSED_VALUE / 1e6)


def test_albedo_and_specular_return_from_their_encodings(picture):
    (albedo, masks), factor = picture, torch.full((3,), 0.25)
    encoded = encode("albedo", albedo, masks, factor)
    assert encoded.abs().max() <= 1
    assert bool((encoded.movedim(1, -1)[masks == 0] == 0).all())
    torch.testing.assert_close(decode("albedo", encoded, masks, torch.full((3,), 0.5)), albedo, atol=1e-5, rtol=0)
    specular = albedo / 0.25
    encoded = encode("specular", specular, masks, factor)
    torch.testing.assert_close(decode("specular", encoded, masks, factor), specular, atol=1e-4, rtol=1e-4)
    beyond = decode("specular", encode("specular", 100 * specular, masks, factor), masks, factor)
    assert beyond.max() <= 1 / 0.25 * 1.0001
    # half precision
    albedo = torch.rand(4, 8, 8, 3, generator=torch.Generator().manual_seed(0))
    masks, one = torch.ones(4, 8, 8), torch.ones(4)
    back = decode("albedo", encode("albedo", albedo.half().float(), masks, one).half().float(), masks, one)
    torch.testing.assert_close(back, albedo, rtol=2e-3, atol=2e-4)


def test_tone_map_and_its_slope_have_the_digits_of_float64_from_1e_30_to_1e30():
    radiance = torch.logspace(-30, 30, 200).requires_grad_(True)
    exact = radiance.detach().double().requires_grad_(True)
    value, reference = tone_map(radiance), tone_map(exact)
    slopes = [torch.autograd.grad(mapped.sum(), given)[0] for mapped, given in ((value, radiance), (reference, exact))]
    torch.testing.assert_close(value.double(), reference, rtol=1e-5, atol=1e-17)
    torch.testing.assert_close(slopes[0].double(), slopes[1], rtol=1e-4, atol=1e-16)
