"""What may be set of InvRender."""

from __future__ import annotations

from dataclasses import dataclass

from ia_bench.common.ranges import Count, Number, Positive, Rate, Weight


@dataclass(frozen=True)
class InvRenderOptions:
    """What the original has otherwise is in card.md.

    Attributes:
        radiance_steps: Adam steps of the radiance field, which says what parts of the object send to each other.
        indirect_steps: Adam steps of the indirect light's spherical Gaussians; 0 leaves indirect light out.
        steps: Adam steps of material and light.
        pixels: Training pixels of a step, of all views.
        texels: Surface points of a step of the indirect light.
        width: Of the hidden layers of all networks but the decoder.
        octaves: Of the encoding of positions; the last one's period is 2 pi / 2^(octaves - 1) of half the object's extent: with 7
            about five pixels where the object fills an image of 128, as with the original's 10 in one of 800.
        network_rate: Adam rate of networks.
        light_rate: Adam rate of the light's axes and of the logarithms of its sharpness and amplitude.
        final_rate: What the rates fall to over a phase, as a fraction.
        sparsity: Weight of the divergence that keeps latent codes sparse.
        smoothness: Weight of the change of the material where its latent code is perturbed.
        directions: Over the sphere, in which what every texel of the atlas sees of the object is traced once, for indirect light.
        atlas: Texels along a side of the atlas of points that indirect light is known at.
        texture: Texels along a side of the textures that the material is written to.
    """

    radiance_steps: Number = 800
    indirect_steps: Count = 400
    steps: Number = 1800
    pixels: Number = 512
    texels: Number = 256
    width: Number = 128
    octaves: Number = 7
    network_rate: Rate = 4e-3
    light_rate: Rate = 0.05
    final_rate: Positive = 0.1
    sparsity: Weight = 0.01
    smoothness: Weight = 0.1
    directions: Number = 256
    atlas: Number = 128
    texture: Number = 512
