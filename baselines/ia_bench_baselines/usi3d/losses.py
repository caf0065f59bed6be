"""The losses of three-domain translation: L1 inside masks, least-squares adversaries, and the physical loss."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from ia_bench.common.ranges import Weight
from ia_bench_baselines.common.training import masked_mean
from ia_bench_baselines.usi3d.networks import Discriminator, ThreeDomains, Translation


@dataclass(frozen=True)
class Weights:
    """Weights of the generators' losses; those of the authors for ShapeNet.

    Attributes:
        adversarial: That a discriminator takes a translation for a picture of its domain.
        picture: That a picture comes back from its own content and style.
        style: That a style comes back from what was made with it, and an image's from its split styles.
        content: That a content comes back from what was made of it.
        cycle: That a picture comes back from the content of its translation and its own style.
        physical: That the image is albedo times shading.
    """

    adversarial: Weight = 1.0
    picture: Weight = 10.0
    style: Weight = 0.01
    content: Weight = 0.01
    cycle: Weight = 10.0
    physical: Weight = 1.0


@dataclass(frozen=True)
class Domains:
    """Pictures (N, 4, S, S) of the three domains, of other objects in each, and random styles (N, STYLE) of two of them."""

    image: Tensor
    albedo: Tensor
    shading: Tensor
    albedo_style: Tensor
    shading_style: Tensor


@dataclass(frozen=True)
class Translated:
    """What the generators make of :class:`Domains` for the discriminators to judge.

    Attributes:
        of_image: The images taken apart.
        albedo: Shadings turned into albedos of random styles.
        shading: Albedos turned into shadings of random styles.
        own: Domain -> content and style of its own pictures.
    """

    of_image: Translation
    albedo: Tensor
    shading: Tensor
    own: Mapping[str, tuple[Tensor, Tensor]]


def translate(networks: ThreeDomains, shown: Domains) -> Translated:
    """Every translation of a step."""
    of_image = networks.translate(shown.image)
    albedo, shading = networks.albedo.encode(shown.albedo), networks.shading.encode(shown.shading)
    return Translated(
        of_image,
        networks.albedo.decode(shading[0], shown.albedo_style, shown.shading[:, 3:]),
        networks.shading.decode(albedo[0], shown.shading_style, shown.albedo[:, 3:]),
        {"image": (of_image.content, of_image.style), "albedo": albedo, "shading": shading},
    )


def picture_error(found: Tensor, wanted: Tensor) -> Tensor:
    """Mean absolute difference of the colours of two pictures (N, 4, S, S) inside the second's mask."""
    return masked_mean((found[:, :3] - wanted[:, :3]).abs(), wanted[:, 3:])


def physical_error(image: Tensor, albedo: Tensor, shading: Tensor) -> Tensor:
    """Mean |I - R S| inside the image's mask, of display values in [0, 1].

    The product holds of linear values. A power law would leave it a product, and the sRGB curve nearly is one.
    """
    colours = [0.5 + 0.5 * picture[:, :3] for picture in (image, albedo, shading)]
    return masked_mean((colours[0] - colours[1] * colours[2]).abs(), image[:, 3:])


def toward(verdict: Tensor, wanted: float) -> Tensor:
    """Least squares (Mao et al. 2017): mean squared distance of a discriminator's verdict from ``wanted``."""
    return (verdict - wanted).square().mean()


def discriminator_loss(judge: Discriminator, true: Tensor, made: tuple[Tensor, ...]) -> Tensor:
    """True pictures toward 1, each kind of made ones toward 0."""
    right = toward(judge(true), 1)
    losses = [toward(judge(picture.detach()), 0) + right for picture in made]
    return torch.stack(losses).sum()


def generator_losses(
    networks: ThreeDomains, albedo_judge: Discriminator, shading_judge: Discriminator, shown: Domains, made: Translated
) -> dict[str, Tensor]:
    """The losses by the names of :class:`Weights`, each a sum over domains or translations."""
    image, albedo, shading = networks.image, networks.albedo, networks.shading
    of_image, own = made.of_image, made.own

    # ---------------------------------------------------------------- every picture again, from its own content and style
    domains = {"image": (image, shown.image), "albedo": (albedo, shown.albedo), "shading": (shading, shown.shading)}
    again = [picture_error(net.decode(*own[name], picture[:, 3:]), picture) for name, (net, picture) in domains.items()]

    # ---------------------------------------------------------------- every translation, encoded again
    # translation, the network of its domain, the content and the style that it was made with, and which picture it came from
    translations = (
        (of_image.albedo, albedo, of_image.content, of_image.split[0], "image"),
        (of_image.shading, shading, of_image.content, of_image.split[1], "image"),
        (made.albedo, albedo, own["shading"][0], shown.albedo_style, "shading"),
        (made.shading, shading, own["albedo"][0], shown.shading_style, "albedo"),
    )
    styles = [(networks.merger(*of_image.split) - of_image.style).abs().mean()]
    contents, cycles = [], []
    for picture, net, content, style, source in translations:
        content_again, style_again = net.encode(picture)
        contents.append((content_again - content).abs().mean())
        styles.append((style_again - style).abs().mean())
        source_net, source_picture = domains[source]
        back = source_net.decode(content_again, own[source][1], source_picture[:, 3:])
        cycles.append(picture_error(back, source_picture))

    fooled = [toward(albedo_judge(picture), 1) for picture in (of_image.albedo, made.albedo)]
    fooled += [toward(shading_judge(picture), 1) for picture in (of_image.shading, made.shading)]
    sums = {"adversarial": fooled, "picture": again, "style": styles, "content": contents, "cycle": cycles}
    physical = physical_error(shown.image, of_image.albedo, of_image.shading)
    return {**{name: torch.stack(losses).sum() for name, losses in sums.items()}, "physical": physical}
