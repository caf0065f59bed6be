import torch

from ia_bench.priors.diffusion.framing import Frame


def disc(height, width, row, column, radius):
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    return ((rows - row) ** 2 + (columns - column) ** 2 <= radius**2).float()


def test_without_resizing_cut_and_paste_are_inverse():
    mask = disc(40, 50, 18, 30, 9)
    values = torch.rand(40, 50, 3, generator=torch.Generator().manual_seed(0))
    frame = Frame.around(mask, None)
    assert frame.side % 8 == 0
    again = frame.paste(frame.cut(values), torch.ones(frame.side, frame.side), mask)
    torch.testing.assert_close(again, values * mask[..., None])


def test_an_object_at_the_border_is_cut_with_zeros_beyond_it():
    mask = disc(32, 32, 0, 31, 12)
    frame = Frame.around(mask, None)
    assert frame.top < 0 or frame.left + frame.length > 32
    again = frame.paste(frame.cut(mask[..., None]), torch.ones(frame.side, frame.side), mask)
    torch.testing.assert_close(again[..., 0], mask)


def test_a_constant_colour_survives_resizing_up_to_the_edge():
    mask = disc(100, 100, 50, 50, 37)
    frame = Frame.around(mask, 32)
    weight = (frame.cut(mask[..., None])[..., 0] > 0).float()
    colour = torch.tensor([0.2, 0.5, 0.9])
    again = frame.paste(colour.expand(32, 32, 3) * weight[..., None] + 7 * (1 - weight[..., None]), weight, mask)
    torch.testing.assert_close(again, colour * mask[..., None], atol=1e-5, rtol=0)


def test_an_empty_mask_has_no_frame():
    assert Frame.around(torch.zeros(5, 5), 8) is None


def test_one_pixel_has_one():
    mask = torch.zeros(9, 9)
    mask[3, 7] = 1
    frame = Frame.around(mask, 16)
    again = frame.paste(torch.full((16, 16, 3), 0.4), torch.ones(16, 16), mask)
    torch.testing.assert_close(again[3, 7], torch.full((3,), 0.4))
    assert again.sum() == again[3, 7].sum()
