"""Import torchvision where its compiled operators do not load; ``lpips`` needs torchvision only for its networks.

torchvision's wheel on the package index is built against torch with CUDA. Beside a CPU build of torch its operators are
not registered, and ``import torchvision`` raises "operator torchvision::nms does not exist" while it declares shape
rules for two of them. Those two (non-maximum suppression) serve object detectors only, so declaring their signatures,
without an implementation, makes the import pass and costs nothing. With a matching pair of wheels nothing is done here.
"""

from __future__ import annotations

_SIGNATURES = tuple(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor" for name in ("nms", "qnms"))

_declared: list[object] = []  # torch forgets an operator when the library that declared it is collected


def import_torchvision() -> None:
    """Import torchvision, declaring its two missing operators first if, and only if, the import fails for lack of them.

    Raises ImportError where torchvision is not installed, and whatever else its import raises.
    """
    try:
        import torchvision
    except RuntimeError as error:
        if "operator torchvision::" not in str(error) or _declared:
            raise
        import torch

        library = torch.library.Library("torchvision", "DEF")
        for signature in _SIGNATURES:
            library.define(signature)
        _declared.append(library)
        import torchvision  # noqa: F401
