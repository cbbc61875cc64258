from __future__ import annotations

import io
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from proground_log.errors import ProgroundError
from recorders.reading.npy import read_npy_image


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


@pytest.mark.parametrize("kind", ["<f4", ">f8", "<f2", "<u2", ">i4", "u1"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_numbers_come_back(tmp_path: Path, kind: str, order: str) -> None:
    image = np.arange(12).reshape(3, 4).astype(kind, order=order)  # type: ignore[call-overload]
    (tmp_path / "a.npy").write_bytes(npy(image))
    found = read_npy_image(tmp_path / "a.npy")
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, np.arange(12).reshape(3, 4))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "is not an image"),
        (b"\x89PNG\r\n", "is not an image"),
        (npy(np.zeros((3, 4)))[:60], "is not an image"),
        (npy(np.zeros((3, 4)))[:-1], "has 95 bytes for 4x3 of float64"),
        (npy(np.zeros((3, 4))) + b"0", "has 97 bytes"),
        (npy(np.zeros((3, 4, 3))), "one number a pixel"),
        (npy(np.zeros((0, 4))), "one number a pixel"),
        (npy(np.zeros((3, 4), complex)), "one number a pixel"),
        (npy(np.zeros((3, 4), object)), "one number a pixel"),
        (npy(np.array(["deep"] * 4).reshape(2, 2)), "one number a pixel"),
    ],
)
def test_a_broken_file_is_named(tmp_path: Path, data: bytes, message: str) -> None:
    path = tmp_path / "a.npy"
    path.write_bytes(data)
    with pytest.raises(ProgroundError, match=message) as caught:
        read_npy_image(path)
    assert caught.value.where == str(path)


def test_a_size_that_the_file_has_not_reserves_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    small, huge = b"(10, 10), }            ", b"(10000000, 10000000), }"
    path.write_bytes(npy(np.zeros((10, 10))).replace(small, huge))
    tracemalloc.start()
    with pytest.raises(ProgroundError, match="has 800 bytes for 10000000x10000000"):
        read_npy_image(path)
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()


def test_mutations_give_an_error_or_an_image(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    whole = npy(rng.random((6, 8)).astype(np.float32))
    path = tmp_path / "a.npy"
    for _ in range(600):
        data = bytearray(whole)
        for at in rng.integers(0, 140, rng.integers(1, 4)):
            data[at] = rng.integers(256)
        path.write_bytes(data[: rng.integers(0, len(data))] if rng.random() < 0.3 else data)
        try:
            image = read_npy_image(path)
        except ProgroundError:
            continue
        assert image.ndim == 2
        assert image.size <= len(whole)
