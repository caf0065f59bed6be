"""What the specular lobe reflects in all, and what it leaves to the diffuse one."""

import torch

from benchmarks.reference import passed_by_coat
from ia_bench.material.brdf import coat_reflectance


def test_coat_table_between_its_cells() -> None:
    """At the table's own values it is the table; its slope in the roughness is that of differences."""
    table = coat_reflectance()
    values = torch.linspace(0, 1, len(table))
    roughness, cosine = (grid.reshape(-1, 1) for grid in torch.meshgrid(values, values, indexing="ij"))
    torch.testing.assert_close(passed_by_coat(roughness, cosine), 1 - table.reshape(-1, 1), atol=1e-5, rtol=0)
    inside = torch.tensor([[0.33], [0.71]], requires_grad=True)
    (slope,) = torch.autograd.grad(passed_by_coat(inside, torch.tensor([[0.4], [0.9]])).sum(), inside)
    step = 1e-3
    differences = [passed_by_coat(inside.detach() + s, torch.tensor([[0.4], [0.9]])) for s in (step, -step)]
    torch.testing.assert_close(slope, (differences[0] - differences[1]) / (2 * step), atol=1e-3, rtol=0.02)
