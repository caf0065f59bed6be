"""The stiffness measurement: products with J against finite differences and a dense J, spectra against known ones, one scene.

Analytic cases are float64 and exact; products of a renderer are float32.
"""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from benchmarks.stiffness import spectrum
from benchmarks.stiffness.__main__ import main
from benchmarks.stiffness.gauss_newton import Jacobian, gram
from benchmarks.stiffness.stage import TruthOfAFit
from ia_bench.common.errors import InputError
from ia_bench.common.paths import scenes_folders


def made_up() -> tuple[Tensor, dict[str, Tensor]]:
    """11 x 3 residuals, channel by channel, of 5 albedos, 5 roughnesses and 4 x 3 lights, the last albedo unused; float64."""
    random = torch.Generator().manual_seed(3)

    def leaf(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=random, dtype=torch.float64).requires_grad_()

    parameters = {"albedo": leaf(5, 1, 3), "roughness": leaf(5, 1, 1), "log_light": leaf(2, 2, 3)}
    paint, shine, form = (torch.rand(11, n, generator=random, dtype=torch.float64) for n in (4, 5, 4))
    light = torch.exp(parameters["log_light"]).reshape(4, 3)
    diffuse = (paint @ parameters["albedo"][:4].reshape(4, 3)) * (form @ light)
    glossy = (shine @ parameters["roughness"].reshape(5, 1) ** 2).sqrt() * (form**2 @ light)
    return torch.log1p(diffuse + glossy), parameters


def dense(residual: Tensor, parameters: dict[str, Tensor]) -> np.ndarray:
    """J row by row, by reverse mode."""
    rows = [torch.autograd.grad(r, list(parameters.values()), retain_graph=True) for r in residual.reshape(-1)]
    return np.stack([torch.cat([part.reshape(-1) for part in row]).numpy() for row in rows])


# ---- products --------------------------------------------------------------------------------------------------------
def test_products_gram_and_what_is_seen_are_those_of_the_dense_jacobian() -> None:
    residual, parameters = made_up()
    j, jacobian = dense(residual, parameters), Jacobian(residual, parameters)
    assert (jacobian.rows, jacobian.columns) == j.shape
    vector, cotangent = torch.randn(jacobian.columns).double(), torch.randn(residual.shape).double()
    np.testing.assert_allclose(jacobian.forward(vector).reshape(-1), j @ vector.numpy(), rtol=1e-12)
    np.testing.assert_allclose(jacobian.backward(cotangent), j.T @ cotangent.reshape(-1).numpy(), rtol=1e-12, atol=1e-14)
    product = jacobian.gauss_newton() @ vector.numpy()
    np.testing.assert_allclose(product, j.T @ (j @ vector.numpy()) / len(j), rtol=1e-11, atol=1e-14)
    seen = jacobian.columns_seen().numpy()
    assert (~seen).nonzero()[0].tolist() == [12, 13, 14]  # the albedo that nothing depends on
    np.testing.assert_allclose(gram(jacobian, seen), (j.T @ j)[np.ix_(seen, seen)], rtol=1e-5, atol=1e-9)  # J itself is float32


@pytest.fixture(scope="module")
def stage() -> TruthOfAFit:
    return TruthOfAFit.at_truth(scenes_folders()[0] / "tiny", samples=32)


def test_forward_product_of_the_renderer_against_finite_differences(stage: TruthOfAFit) -> None:
    """In albedo and light, with every sample fixed: directions follow the roughness, which therefore stays.

    Central differences of 0.001 in float32, of values near 0.3: rounding is 1e-4, truncation less but near black, where the tone
    map is steep.
    """
    pixels = stage.pixels(200)
    jacobian = stage.jacobian(pixels, 8, 8)
    random = torch.Generator().manual_seed(0)
    direction = torch.randn(jacobian.columns, generator=random)
    direction[jacobian.slices["roughness"]] = 0
    moved = {name: direction[part].reshape(jacobian.parameters[name].shape) for name, part in jacobian.slices.items()}
    found = jacobian.forward(direction)
    ends = [stage.tone_mapped(pixels, {name: sign * 0.001 * m for name, m in moved.items()}, seed=0) for sign in (1, -1)]
    difference = (ends[0] - ends[1]) / 0.002
    assert float((found - difference).norm()) < 1e-3 * float(difference.norm())


def test_products_of_the_renderer_are_adjoint_and_its_channels_apart(stage: TruthOfAFit) -> None:
    jacobian = stage.jacobian(stage.pixels(200), 4, 4)
    random = torch.Generator().manual_seed(0)
    vector, cotangent = torch.randn(jacobian.columns, generator=random), torch.randn(200, 3, generator=random)
    left, right = (jacobian.forward(vector) * cotangent).sum(), (jacobian.backward(cotangent) * vector).sum()
    assert float((left - right).abs()) < 1e-5 * float(jacobian.forward(vector).norm() * cotangent.norm())
    one_by_one = torch.stack([jacobian.forward(column).reshape(-1) for column in torch.eye(jacobian.columns)]).double().numpy()
    seen = jacobian.columns_seen().numpy()
    expected = (one_by_one @ one_by_one.T)[np.ix_(seen, seen)]
    np.testing.assert_allclose(gram(jacobian, seen), expected, rtol=1e-5, atol=1e-7 * expected.max())


# ---- spectra ---------------------------------------------------------------------------------------------------------
def test_a_rate_each_undoes_units_and_nothing_else() -> None:
    random = np.random.default_rng(0)
    j = random.standard_normal((50, 6))
    units = 10.0 ** random.uniform(-4, 4, 6)
    np.testing.assert_allclose(spectrum.jacobi((j * units).T @ (j * units)), spectrum.jacobi(j.T @ j), rtol=1e-10, atol=1e-12)
    assert np.diag(spectrum.jacobi(j.T @ j)) == pytest.approx(1)


def two_parameters(correlation: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    return np.array([[4.0, 2e-3 * correlation], [2e-3 * correlation, 1e-6]]), {"a": np.array([0]), "b": np.array([1])}


def test_confusion_of_two_parameters_is_one_minus_their_correlation() -> None:
    """Whatever their units; the direction weighs both by what they do alone."""
    matrix, groups = two_parameters(0.9)
    mu, directions = spectrum.confusions(matrix, groups)
    np.testing.assert_allclose(mu, [0.1, 1.9], rtol=1e-12)
    assert abs(directions[0, 0] / directions[1, 0]) == pytest.approx(1e-3 / 2)
    assert directions[0, 0] * directions[1, 0] < 0
    assert spectrum.cancellation(matrix, groups, directions[:, 0]) == pytest.approx(0.1)
    assert spectrum.kept_information(matrix, groups) == pytest.approx({"a": 0.19, "b": 0.19}, rel=1e-6)


def test_a_product_is_confused_in_its_scale_alone() -> None:
    """Images a_i l_j of every pair: log a + log l has one exact null, log a up and log l down, and no other confusion below 1."""
    design = np.array([[float(i == k) for k in range(4)] + [float(j == k) for k in range(3)] for i in range(4) for j in range(3)])
    groups = {"albedo": np.arange(4), "light": np.arange(4, 7)}
    matrix = design.T @ design
    mu, directions = spectrum.confusions(matrix, groups)
    np.testing.assert_allclose(mu, [0, 1, 1, 1, 1, 1, 2], atol=1e-12)
    np.testing.assert_allclose(directions[:, 0] / directions[0, 0], [1, 1, 1, 1, -1, -1, -1], rtol=1e-9)
    kept = spectrum.kept_information(matrix, groups)
    assert kept["albedo"] == pytest.approx(3 / 4, rel=1e-6)  # H_aa = 3 I, of which the common part, 1/4, is lost
    assert kept["light"] == pytest.approx(2 / 3, rel=1e-6)


# ---- the command -----------------------------------------------------------------------------------------------------
def test_the_command_measures_a_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small = ["--pixels", "300", "--samples", "8", "--texture", "4", "--light", "4", "--directions", "2"]
    assert main(["tiny", "--out", str(tmp_path), *small]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert [line.split(" | ")[0] for line in printed] == ["| scene", "| :---", "| tiny"]
    numbers = json.loads((tmp_path / "stiffness.json").read_text())["tiny"]
    assert sum(numbers["parameters"].values()) + sum(numbers["unseen"].values()) == 4 * 4 * 4 + 4 * 8 * 3
    assert numbers["condition"] > numbers["condition_jacobi"] > 1
    for shares in (numbers["shares_flattest_tenth"], numbers["shares_stiffest_percent"], *numbers["fit_resolution"]["shares"]):
        assert sum(shares.values()) == pytest.approx(1, abs=1e-5)
    cast = numbers["casts"]["all"]
    assert 0 < cast["mu"] < 1  # light and paint compensate each other in part
    assert cast["image_change"] < cast["light_alone"]
    for name in ("linear", "softplus"):  # one factor a parameter, which a rate each undoes
        assert numbers["light_parametrisations"][name]["condition_jacobi"] == pytest.approx(numbers["condition_jacobi"], rel=1e-6)
    assert {path.name for path in tmp_path.iterdir()} == {"stiffness.json", "spectra.png", "tiny.png"}


def test_what_cannot_be_measured_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str], stage: TruthOfAFit) -> None:
    assert main(["nothing-of-that-name", "--out", str(tmp_path)]) == 2
    assert "nothing-of-that-name" in capsys.readouterr().err
    with pytest.raises(InputError, match="expected divisors of the plan's 128 texels and 16 light rows, found 48, 16"):
        stage.jacobian(stage.pixels(10), 48, 16)
