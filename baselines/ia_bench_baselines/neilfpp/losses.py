"""What NeILF++ asks beside the images: light that agrees with the surface that sends it, little metal, smooth material."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.render.stage import Stage
from ia_bench_baselines.neilfpp.fields import Neilf

LUMINANCE = (0.2126, 0.7152, 0.0722)  # of linear Rec.709
OUTGOING_SHARE = 0.7  # of the trace loss's gradient that reaches the surface light field


def second_hits(stage: Stage, position: Tensor, geometric: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
    """Which rays from surface points hit a front, and where.

    Args:
        stage: Of the mesh.
        position: (T, 3) points that the rays start from.
        geometric: (T, 3) normals of their triangles, along which the rays' origins are lifted off the surface.
        directions: (T, 3) unit.

    Returns:
        The indices (H,) of the rays that hit, and the positions (H, 3).
    """
    face, barycentric, _ = stage.rays.intersect(position + stage.surface.offset * geometric, directions)
    hit = torch.nonzero(face >= 0)[:, 0]
    normal, position = stage.surface.geometry(face[hit], barycentric[hit])
    front = (normal * directions[hit]).sum(1) < 0
    return hit[front], position[front]


def trace_loss(neilf: Neilf, incident: Tensor, hits: Tensor, directions: Tensor, *, held: bool) -> Tensor:
    """The mean absolute difference between incident light and what the surface sends out where the ray hits it.

    Args:
        neilf: The fields.
        incident: (H, 3) incident light along rays that hit.
        hits: (H, 3) where they do.
        directions: (H, 3) of the rays.
        held: Whether the surface light field is not trained.
    """
    if len(hits) == 0:
        return incident.new_zeros(())
    outgoing = neilf.outgoing(neilf.local(hits), -directions)
    held_part = outgoing.detach()
    outgoing = held_part if held else held_part + OUTGOING_SHARE * (outgoing - held_part)
    return (incident - outgoing).abs().mean()


def smoothness(local: Tensor, roughness: Tensor, metallic: Tensor, edges: Tensor) -> Tensor:
    """The mean of (|grad r| + |grad m|) exp(-edge), gradients by ``local`` positions (N, 3); ``edges`` (N,) of the images."""
    total = local.new_zeros(len(local))
    for values in (roughness, metallic):
        (gradient,) = torch.autograd.grad(values.sum(), local, create_graph=True)
        total = total + torch.sqrt(gradient.square().sum(1) + 1e-12)  # with a finite gradient where the field is constant
    return (total * torch.exp(-edges)).mean()


def scharr_edges(images: Tensor) -> Tensor:
    """The length (V, H, W) of Scharr's 3 x 3 filters, not normalised, on the luminance of linear images (V, H, W, 3).

    A step of D has 16 D on both of its sides.
    """
    across = torch.tensor([[-3.0, 0, 3], [-10, 0, 10], [-3, 0, 3]], device=images.device)
    kernels = torch.stack([across, across.T])[:, None]
    padded = torch.nn.functional.pad((images @ images.new_tensor(LUMINANCE))[:, None], (1, 1, 1, 1), mode="replicate")
    return torch.nn.functional.conv2d(padded, kernels).norm(dim=1)
