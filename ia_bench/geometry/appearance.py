"""The colour of a surface as it was photographed, without a model of light: a part that is seen from everywhere, and a shine."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import softplus

from ia_bench.geometry.warp_march import CHANNELS

HIDDEN = 32
BEGINNING = -3.0  # what the shine's last layer starts with: softplus of it is .05 of the mean colour


class Appearance(nn.Module):
    """Linear colour (N, 3) of features (N, CHANNELS), unit normals and directions of rays (N, 3).

    softplus(the first three features) + softplus(network(the other features, normal, mirrored direction, cosine)). Under light that
    does not move, the first is all that a matt surface shows, whatever its shadows.
    """

    def __init__(self, generator: torch.Generator) -> None:
        super().__init__()
        sizes = CHANNELS - 3 + 2 * 15 + 1, HIDDEN, HIDDEN, 3
        layers = [nn.Linear(*pair) for pair in zip(sizes, sizes[1:], strict=False)]
        for layer in layers:
            bound = layer.in_features**-0.5
            with torch.no_grad():
                layer.weight.uniform_(-bound, bound, generator=generator)
                layer.bias.zero_()
        nn.init.constant_(layers[-1].bias, BEGINNING)
        self.network = nn.Sequential(layers[0], nn.ReLU(), layers[1], nn.ReLU(), layers[2])

    def forward(self, features: Tensor, normals: Tensor, directions: Tensor) -> Tensor:
        """See the class."""
        cosine = (normals * directions).sum(-1, keepdim=True)
        mirrored = directions - 2 * cosine * normals
        known = torch.cat([features[:, 3:], harmonics(normals), harmonics(mirrored), cosine], -1)
        return softplus(features[:, :3]) + softplus(self.network(known))


def harmonics(d: Tensor) -> Tensor:
    """Real spherical harmonics of degrees 1 to 3 at unit directions (N, 3), each up to a factor: (N, 15)."""
    x, y, z = d.unbind(-1)
    first = [x, y, z]
    second = [x * y, y * z, x * z, x * x - y * y, 3 * z * z - 1]
    third = [x * (x * x - 3 * y * y), y * (3 * x * x - y * y), z * (x * x - y * y), x * y * z]
    third += [x * (5 * z * z - 1), y * (5 * z * z - 1), z * (5 * z * z - 3)]
    return torch.stack(first + second + third, -1)
