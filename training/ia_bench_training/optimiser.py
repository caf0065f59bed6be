"""The optimiser of training: Muon for the weights that are matrices, AdamW for the rest."""

from __future__ import annotations

from typing import Any

import torch
from torch import nn

NOT_HIDDEN = ("conv_in.", "conv_out.", "position", "time_")
"""Parts of names of weights that meet the input, the output or an embedding, where Muon's authors keep Adam."""
SMALLEST = 16  # rows or columns of a weight that is worth a matrix's step


class MuonAdamW:
    """Muon (Jordan et al. 2024) on the hidden weights of a network, AdamW on all others.

    Muon takes the momentum of a weight as a matrix and makes its singular values equal, so that no direction of a layer
    waits for the others. A convolution is the matrix (outputs, inputs x window) here; ``torch.optim.Muon`` takes
    matrices only, and is given views: the weights must stay in the memory in which they are now.
    """

    def __init__(self, adamw: Any, hidden: list[nn.Parameter], *, muon_rate: float, weight_decay: float) -> None:  # noqa: ANN401
        """``adamw``: over the other weights, as accelerate prepared it; its rate is its own. ``hidden``: may be empty."""
        self.adamw = adamw
        self._hidden = hidden
        self._matrices = [nn.Parameter(weight.detach().view(len(weight), -1)) for weight in hidden]
        self._rates = [group["lr"] for group in adamw.param_groups]
        self._muon_rate = muon_rate
        self._muon = torch.optim.Muon(self._matrices, lr=muon_rate, weight_decay=weight_decay) if hidden else None

    def step(self, share: float) -> None:
        """One step at ``share`` of the full rates; the gradients are forgotten."""
        for group, rate in zip(self.adamw.param_groups, self._rates, strict=True):
            group["lr"] = share * rate
        self.adamw.step()
        self.adamw.zero_grad(set_to_none=True)
        if self._muon is None:
            return
        for weight, matrix in zip(self._hidden, self._matrices, strict=True):
            matrix.grad = None if weight.grad is None else weight.grad.reshape(matrix.shape)
        for group in self._muon.param_groups:
            group["lr"] = share * self._muon_rate
        self._muon.step()
        for weight, matrix in zip(self._hidden, self._matrices, strict=True):
            weight.grad = matrix.grad = None

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint must keep."""
        return {"adamw": self.adamw.state_dict(), "muon": None if self._muon is None else self._muon.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from :meth:`state_dict`."""
        self.adamw.load_state_dict(state["adamw"])
        if self._muon is not None:
            self._muon.load_state_dict(state["muon"])


def split_weights(network: nn.Module, *, muon: bool) -> tuple[list[nn.Parameter], list[nn.Parameter]]:
    """The trained weights of ``network`` that Muon steps (none without ``muon``), and those that are left to AdamW."""
    trained = [(name, weight) for name, weight in network.named_parameters() if weight.requires_grad]
    hidden = [weight for name, weight in trained if muon and _is_hidden(name, weight)]
    return hidden, [weight for name, weight in trained if not (muon and _is_hidden(name, weight))]


def _is_hidden(name: str, weight: nn.Parameter) -> bool:
    if weight.ndim < 2 or any(part in name for part in NOT_HIDDEN):
        return False
    return min(len(weight), weight[0].numel()) >= SMALLEST
