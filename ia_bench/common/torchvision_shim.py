"""Import torchvision where its compiled operators do not load; ``lpips`` needs torchvision only for its networks.

torchvision's wheel on the package index is built against torch with CUDA. Beside a CPU build of torch ``import torchvision``
raises "operator torchvision::nms does not exist", for two operators of object detectors; to declare their signatures makes it pass.
"""

from __future__ import annotations

_SIGNATURES = tuple(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor" for name in ("nms", "qnms"))

_declared: list[object] = []  # torch forgets an operator when the library that declared it is collected


def import_torchvision() -> None:
    """Import torchvision, declaring its two missing operators if the import fails for lack of them. Raises ImportError."""
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
