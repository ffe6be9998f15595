"""Cross-shell invariants and powers of Gram matrices: the NumPy layer's numbers, and gradients where values repeat."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsh3d_o3d.sphere import gram_powers
from tests.optional import WITHOUT_TORCH

torch = pytest.importorskip("torch", reason=WITHOUT_TORCH)

from fsh3d_o3d import torch as ft  # noqa: E402
from fsh3d_o3d.torch.matrix_powers import gram_power  # noqa: E402
from tests.torch.cases import difference, randn, rotation  # noqa: E402


@given(st.integers(1, 9), st.integers(1, 10), st.sampled_from([0.25, 0.5, 1.0]), st.sampled_from([0.0, 0.01, 1.0]))
def test_the_numbers_are_those_of_the_numpy_layer(functions, b, power, epsilon):
    coefficients = randn(2, functions, b * b, seed=functions)
    found = ft.cross_shell_invariants(coefficients, power, epsilon)
    expected = [gram_powers(one.numpy(), b, power, epsilon) for one in coefficients]
    assert difference(found, torch.stack(list(map(torch.from_numpy, expected)))) < 1e-13


@pytest.mark.parametrize(("functions", "b"), [(1, 3), (3, 4), (7, 3)])
@pytest.mark.parametrize("power", [0.25, 0.5, 2.0])
def test_gradients(functions, b, power):
    coefficients = randn(2, functions, b * b, grad=True)
    assert torch.autograd.gradcheck(lambda c: ft.cross_shell_invariants(c, power, 0.1), coefficients)
    assert torch.autograd.gradcheck(lambda c: ft.cross_shell_invariants(c).sum(), coefficients)


@pytest.mark.parametrize("gap", [0.0, 1e-15, 1e-12, 1e-9, 1e-6])
def test_repeated_eigenvalues_do_not_disturb_the_gradient(gap):
    """Two singular values that are equal, or nearly: eigenvectors are arbitrary there, the derivative is not."""
    left, right = rotation(1), rotation(2)
    rows = (left * torch.tensor([1.0, 1.0 + gap, 0.3], dtype=torch.float64)) @ right
    rows.requires_grad_()
    assert torch.autograd.gradcheck(lambda x: gram_power(x, 0.25, 0.01), rows)
    weights = randn(3, 3)
    (found,) = torch.autograd.grad((gram_power(rows, 0.25, 0.01) * weights).sum(), rows)
    equal = ((left * torch.tensor([1.0, 1.0, 0.3], dtype=torch.float64)) @ right).requires_grad_()
    (expected,) = torch.autograd.grad((gram_power(equal, 0.25, 0.01) * weights).sum(), equal)
    # It changes as the rows do, by the gap, and not by the gap's inverse.
    assert difference(found, expected) < 10 * gap + 1e-12


def test_a_square_root_against_another_way():
    """Autograd through Newton's iteration for the square root, which knows no eigenvalues."""
    rows, weights = randn(4, 6, grad=True), randn(4, 4, seed=1)
    gram = rows @ rows.mT
    scale = gram.detach().norm()
    root, inverse = gram / scale, torch.eye(4, dtype=torch.float64)
    for _ in range(40):
        step = (3 * torch.eye(4, dtype=torch.float64) - inverse @ root) / 2
        root, inverse = root @ step, step @ inverse
    (expected,) = torch.autograd.grad((root * scale.sqrt() * weights).sum(), rows)
    assert difference(gram_power(rows, 0.5), root.detach() * scale.sqrt()) < 1e-12
    (found,) = torch.autograd.grad((gram_power(rows, 0.5) * weights).sum(), rows)
    assert difference(found, expected) < 1e-9  # forty products with a condition number of a thousand


def test_zero_functions_and_a_floor():
    silent = torch.zeros(3, 16, dtype=torch.float64, requires_grad=True)
    ft.cross_shell_invariants(silent).sum().backward()
    assert torch.equal(silent.grad, torch.zeros_like(silent))
    flat = (rotation(1) * torch.tensor([1.0, 0.6, 1e-4], dtype=torch.float64)) @ randn(3, 9)
    lifted = gram_power(flat, -0.5, 0.0, 0.01)
    assert float(torch.linalg.eigvalsh(lifted)[-1] / torch.linalg.eigvalsh(lifted)[0]) == pytest.approx(10)
    wide = randn(3, 9, grad=True)
    assert torch.autograd.gradcheck(lambda x: gram_power(x, -0.5, 0.0, 1e-3), wide)


def test_they_do_not_notice_rotations():
    coefficients = randn(5, 49)
    turned = ft.rotate_coefficients(coefficients, rotation(4))
    assert difference(ft.cross_shell_invariants(turned), ft.cross_shell_invariants(coefficients)) < 1e-13


def test_compilers():
    compiled = torch.compile(ft.cross_shell_invariants, backend="aot_eager", fullgraph=True)
    coefficients = randn(2, 3, 16, grad=True)
    slopes = [
        torch.autograd.grad(f(coefficients).sum(), coefficients)[0] for f in (compiled, ft.cross_shell_invariants)
    ]
    assert difference(*slopes) < 1e-13


def test_second_derivatives_are_refused_in_words():
    coefficients = randn(2, 9, grad=True)
    (slope,) = torch.autograd.grad(ft.cross_shell_invariants(coefficients).sum(), coefficients, create_graph=True)
    with pytest.raises(RuntimeError, match="first derivatives only"):
        slope.sum().backward()


def test_bad_input_is_named():
    with pytest.raises(ValueError, match=r"shape \(…, R, b²\), got \(9,\)"):
        ft.cross_shell_invariants(randn(9))
    with pytest.raises(ValueError, match="power must be > 0"):
        ft.cross_shell_invariants(randn(2, 9), 0.0)
    assert ft.cross_shell_invariants(randn(0, 2, 9)).shape == (0, 3, 3)
