"""Auto-encoders of three domains that share their content, and the styles that are split and merged between them.

A picture is a content (a map of features, normalised per picture) and a style (a short code, which sets mean and spread of the
decoder's features). Image, albedo and shading of one object share the content. From the style of an image a splitter makes those
of its albedo and its shading, and a merger makes it again of both.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

INPUTS = 4  # colour in [-1, 1], and the mask, so that the grey around the object cannot be taken for paint
WIDTH = 12
CONTENT = 4 * WIDTH
STYLE = 8
RESIDUAL_BLOCKS = 2
HIDDEN = 64  # of the perceptrons
EPSILON = 1e-5


def adaptive_instance_norm(features: Tensor, shift: Tensor, scale: Tensor) -> Tensor:
    """AdaIN (Huang and Belongie 2017): the features with mean ``shift`` and standard deviation |``scale``|, each (N, C)."""
    return F.instance_norm(features, eps=EPSILON) * scale[..., None, None] + shift[..., None, None]


def _perceptron(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, outputs))


class _Residual(nn.Module):
    """Two convolutions beside the identity. Each is normalised, and then takes the mean and spread that it is given, if any."""

    def __init__(self) -> None:
        super().__init__()
        self.first, self.second = (nn.Conv2d(CONTENT, CONTENT, 3, 1, 1, padding_mode="reflect") for _ in range(2))

    def forward(self, features: Tensor, moments: Tensor | None = None) -> Tensor:
        """``moments`` (N, 2, 2, C): of each convolution shift and scale minus one; None for mean 0 and deviation 1."""
        changed = features
        for place, layer in enumerate((self.first, self.second)):
            changed = layer(changed)
            if moments is None:
                changed = F.instance_norm(changed)
            else:
                changed = adaptive_instance_norm(changed, moments[:, place, 0], 1 + moments[:, place, 1])
            changed = F.relu(changed) if place == 0 else changed
        return features + changed


class ContentEncoder(nn.Module):
    """A quarter of the resolution: (N, 4, S, S) to (N, CONTENT, S / 4, S / 4)."""

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Conv2d(INPUTS, WIDTH, 7, 1, 3, padding_mode="reflect")
        self.down = nn.ModuleList(nn.Conv2d(k * WIDTH, 2 * k * WIDTH, 4, 2, 1, padding_mode="reflect") for k in (1, 2))
        self.blocks = nn.ModuleList(_Residual() for _ in range(RESIDUAL_BLOCKS))

    def forward(self, picture: Tensor) -> Tensor:
        """The content of a picture."""
        features = F.relu(F.instance_norm(self.first(picture)))
        for layer in self.down:
            features = F.relu(F.instance_norm(layer(features)))
        for block in self.blocks:
            features = block(features)
        return features


class StyleEncoder(nn.Module):
    """Four times halved, without normalisation, which would take away what a style is: (N, 4, S, S) to (N, STYLE)."""

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Conv2d(INPUTS, WIDTH, 7, 1, 3, padding_mode="reflect")
        widths = (WIDTH, 2 * WIDTH, CONTENT, CONTENT, CONTENT)
        self.down = nn.ModuleList(
            nn.Conv2d(a, b, 4, 2, 1, padding_mode="reflect") for a, b in zip(widths[:-1], widths[1:], strict=True)
        )
        self.last = nn.Linear(CONTENT, STYLE)

    def forward(self, picture: Tensor) -> Tensor:
        """The style of a picture."""
        features = F.relu(self.first(picture))
        for layer in self.down:
            features = F.relu(layer(features))
        found: Tensor = self.last(features.mean((2, 3)))
        return found


class Decoder(nn.Module):
    """Content and style to a picture: (N, CONTENT, S / 4, S / 4) and (N, STYLE) to (N, 3, S, S) in [-1, 1]."""

    def __init__(self) -> None:
        super().__init__()
        self.moments = _perceptron(STYLE, RESIDUAL_BLOCKS * 4 * CONTENT)
        self.blocks = nn.ModuleList(_Residual() for _ in range(RESIDUAL_BLOCKS))
        self.up = nn.ModuleList(nn.Conv2d(k * WIDTH, k * WIDTH // 2, 3, 1, 1, padding_mode="reflect") for k in (4, 2))
        self.norms = nn.ModuleList(nn.GroupNorm(1, k * WIDTH // 2) for k in (4, 2))  # one group: layer normalisation
        self.last = nn.Conv2d(WIDTH, 3, 7, 1, 3, padding_mode="reflect")

    def forward(self, content: Tensor, style: Tensor) -> Tensor:
        """The picture."""
        moments = self.moments(style).unflatten(1, (RESIDUAL_BLOCKS, 2, 2, CONTENT))
        features = content
        for number, block in enumerate(self.blocks):
            features = block(features, moments[:, number])
        for layer, norm in zip(self.up, self.norms, strict=True):
            features = F.relu(norm(layer(F.interpolate(features, scale_factor=2, mode="nearest"))))
        return torch.tanh(self.last(features))


class Domain(nn.Module):
    """The auto-encoder of one domain."""

    def __init__(self) -> None:
        super().__init__()
        self.content, self.style, self.decoder = ContentEncoder(), StyleEncoder(), Decoder()

    def encode(self, picture: Tensor) -> tuple[Tensor, Tensor]:
        """Content and style of a picture (N, 4, S, S)."""
        return self.content(picture), self.style(picture)

    def decode(self, content: Tensor, style: Tensor, mask: Tensor) -> Tensor:
        """The picture (N, 4, S, S) of a content and a style, mid-grey outside ``mask`` (N, 1, S, S)."""
        return torch.cat([self.decoder(content, style) * (mask > 0), mask], 1)


class Splitter(nn.Module):
    """The style of an image to those of its albedo and its shading."""

    def __init__(self) -> None:
        super().__init__()
        self.both = _perceptron(STYLE, 2 * STYLE)

    def forward(self, style: Tensor) -> tuple[Tensor, Tensor]:
        """(N, STYLE) to two of the same shape."""
        albedo, shading = self.both(style).chunk(2, 1)
        return albedo, shading


class Merger(nn.Module):
    """The styles of an albedo and a shading to that of their image."""

    def __init__(self) -> None:
        super().__init__()
        self.both = _perceptron(2 * STYLE, STYLE)

    def forward(self, albedo: Tensor, shading: Tensor) -> Tensor:
        """Two (N, STYLE) to one."""
        found: Tensor = self.both(torch.cat([albedo, shading], 1))
        return found


class Discriminator(nn.Module):
    """How much of a picture looks like one of the domain, patch by patch: (N, 4, S, S) to (N, 1, S / 16, S / 16)."""

    def __init__(self) -> None:
        super().__init__()
        widths = (INPUTS, WIDTH, 2 * WIDTH, CONTENT, 2 * CONTENT)
        self.down = nn.ModuleList(
            nn.Conv2d(a, b, 4, 2, 1, padding_mode="reflect") for a, b in zip(widths[:-1], widths[1:], strict=True)
        )
        self.last = nn.Conv2d(widths[-1], 1, 1)

    def forward(self, picture: Tensor) -> Tensor:
        """1 for true pictures, 0 for made ones, after training."""
        features = picture
        for layer in self.down:
            features = F.leaky_relu(layer(features), 0.2)
        found: Tensor = self.last(features)
        return found


@dataclass(frozen=True)
class Translation:
    """Albedo and shading of images, and where they come from.

    Attributes:
        albedo: Pictures (N, 4, S, S).
        shading: Pictures (N, 4, S, S).
        content: Of the images.
        style: Of the images.
        split: The styles of albedo and shading that were made of the images' ones.
    """

    albedo: Tensor
    shading: Tensor
    content: Tensor
    style: Tensor
    split: tuple[Tensor, Tensor]


class ThreeDomains(nn.Module):
    """The generators of images, albedos and shadings, and the mapping of styles between them."""

    def __init__(self) -> None:
        super().__init__()
        self.image, self.albedo, self.shading = Domain(), Domain(), Domain()
        self.splitter, self.merger = Splitter(), Merger()

    def translate(self, image: Tensor) -> Translation:
        """Take images (N, 4, S, S) apart."""
        content, style = self.image.encode(image)
        split, mask = self.splitter(style), image[:, 3:]
        albedo, shading = self.albedo.decode(content, split[0], mask), self.shading.decode(content, split[1], mask)
        return Translation(albedo, shading, content, style, split)


class AlbedoPath(nn.Module):
    """What of the three domains the prior needs: from an image to its albedo."""

    def __init__(self, whole: ThreeDomains | None = None) -> None:
        super().__init__()
        whole = ThreeDomains() if whole is None else whole
        self.content, self.style, self.splitter = whole.image.content, whole.image.style, whole.splitter
        self.decoder = whole.albedo.decoder

    def forward(self, image: Tensor) -> Tensor:
        """(N, 4, S, S) to albedo (N, 3, S, S) in [-1, 1]."""
        found: Tensor = self.decoder(self.content(image), self.splitter(self.style(image))[0])
        return found
