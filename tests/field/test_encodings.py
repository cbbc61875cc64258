"""The encodings' kernels against plain torch, gradients included, and against their definition."""

from __future__ import annotations

import numba
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from proground_log.field.encodings import (
    HashGridLayout,
    hash_grid,
    hash_grid_torch,
    one_blob,
    one_blob_torch,
)
from proground_log.streams import stream

LAYOUTS = [
    HashGridLayout(levels=16, log2_rows=12, base_resolution=16, finest_resolution=200.0),
    HashGridLayout(levels=4, log2_rows=19, base_resolution=8, finest_resolution=40.0),
    HashGridLayout(levels=1, log2_rows=10, base_resolution=16, finest_resolution=16.0),
]


def points_with_corners(count: int) -> torch.Tensor:
    points = stream(0, "test points").random((count, 3), dtype=np.float32)
    points[:4] = [[0, 0, 0], [1, 1, 1], [1, 0, 0.5], [0.5, 1, 0]]
    return torch.from_numpy(points)


def random_table(layout: HashGridLayout) -> torch.Tensor:
    values = stream(0, "test table").standard_normal((layout.rows, 2)).astype(np.float32)
    return torch.from_numpy(values).requires_grad_()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_hash_grid_equals_plain_torch_with_its_gradient(layout: HashGridLayout) -> None:
    points, table = points_with_corners(3000), random_table(layout)
    ours, reference = hash_grid(points, table, layout), hash_grid_torch(points, table, layout)
    torch.testing.assert_close(ours, reference, atol=1e-6, rtol=1e-6)
    upstream = torch.from_numpy(
        stream(0, "upstream").standard_normal(ours.shape).astype(np.float32)
    )
    (our_gradient,) = torch.autograd.grad(ours, table, upstream)
    (reference_gradient,) = torch.autograd.grad(reference, table, upstream)
    torch.testing.assert_close(our_gradient, reference_gradient, atol=1e-4, rtol=1e-5)
    assert our_gradient.abs().sum() > 0


def test_hash_grid_gradient_is_that_of_finite_differences() -> None:
    layout = HashGridLayout(levels=2, log2_rows=8, base_resolution=3, finest_resolution=9.0)
    points = points_with_corners(20).double()
    table = random_table(layout).double().detach().requires_grad_()
    assert torch.autograd.gradcheck(lambda t: hash_grid_torch(points, t, layout), table)


def test_hash_grid_interpolates_a_linear_function_exactly() -> None:
    layout = HashGridLayout(levels=1, log2_rows=14, base_resolution=16, finest_resolution=16.0)
    side = int(layout.resolutions[0]) + 1
    x, y, z = np.meshgrid(*[np.arange(side)] * 3, indexing="ij")
    rows = (x + side * (y + side * z)).ravel()
    table = np.zeros((layout.rows, 2), np.float32)
    table[rows, 0] = (2 * x - y + 0.5 * z).ravel()
    table[rows, 1] = x.ravel()
    points = points_with_corners(500)
    scaled = points * float(layout.scales[0]) + 0.5
    features = hash_grid(points, torch.from_numpy(table), layout)
    expected = 2 * scaled[:, 0] - scaled[:, 1] + 0.5 * scaled[:, 2]
    torch.testing.assert_close(features[:, 0], expected, atol=1e-4, rtol=1e-5)
    torch.testing.assert_close(features[:, 1], scaled[:, 0], atol=1e-4, rtol=1e-5)


def test_hash_grid_and_one_blob_are_bit_exact_at_any_number_of_threads() -> None:
    layout, most = LAYOUTS[0], numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    points, table = points_with_corners(5001), random_table(layout)

    def everything() -> tuple[bytes, bytes, bytes]:
        features = hash_grid(points, table, layout)
        (gradient,) = torch.autograd.grad(features.square().sum(), table)
        arrays = features.detach(), gradient, one_blob(points)
        a, b, c = (array.numpy().tobytes() for array in arrays)
        return a, b, c

    try:
        numba.set_num_threads(1)
        alone = everything()
        numba.set_num_threads(most)
        assert everything() == alone
    finally:
        numba.set_num_threads(most)


def test_one_blob_equals_plain_torch() -> None:
    points = points_with_corners(2000)
    torch.testing.assert_close(one_blob(points), one_blob_torch(points), atol=1e-6, rtol=0)


@given(st.floats(0, 1, width=32))
def test_one_blob_is_the_mass_of_the_quartic_kernel_in_each_bin(x: float) -> None:
    encoding = one_blob(torch.tensor([[x, 0.25, 0.75]], dtype=torch.float32))[0, :16].numpy()
    assert encoding.sum() == pytest.approx(1, abs=1e-5)
    # Integrate the kernel 15/16 (1 - u^2)^2 numerically, wrapped around, bin by bin.
    u = (np.arange(2000) + 0.5) / 1000 - 1
    mass = 15 / 16 * (1 - u**2) ** 2 / 1000
    bins = np.floor(x * 16 + u).astype(int) % 16
    expected = np.bincount(bins, mass, minlength=16)
    np.testing.assert_allclose(encoding, expected, atol=2e-3)


def test_layout_follows_instant_ngp() -> None:
    layout = HashGridLayout(levels=16, log2_rows=16, base_resolution=16, finest_resolution=256.0)
    growth = (256 / 16) ** (1 / 15)
    np.testing.assert_allclose(layout.scales, 16 * growth ** np.arange(16) - 1, rtol=1e-6)
    assert (layout.resolutions == np.ceil(layout.scales) + 1).all()
    rows = np.diff(layout.offsets)
    assert (rows <= 2**16).all()
    assert (rows[layout.masks > 0] == 2**16).all()
    assert layout.rows == rows.sum()
