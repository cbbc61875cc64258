from __future__ import annotations

import numpy as np
import pytest

from proground_log.errors import ProgroundError
from recorders.formats.ros.compressed_depth import decode_compressed_depth, decode_rvl
from tests.writers.ros_bags import png, rvl

HEADER = bytes(12)


def some_depth() -> np.ndarray:
    rng = np.random.default_rng(3)
    depth = rng.integers(0, 65536, (12, 17), dtype=np.uint16)
    depth[rng.random(depth.shape) < 0.4] = 0
    return depth


@pytest.mark.parametrize(
    "depth",
    [some_depth(), np.zeros((5, 7), np.uint16), np.full((1, 9), 65535, np.uint16)],
    ids=["random", "nothing", "full"],
)
def test_rvl_gives_back_what_was_put_in(depth: np.ndarray) -> None:
    size = (depth.shape[1], depth.shape[0])
    np.testing.assert_array_equal(decode_rvl(rvl(depth), size, where="here"), depth)


def test_rvl_of_the_paper_s_order() -> None:
    # Runs of 1 zero and 2 others, 5 and then 3: +5 is 10 = 1|010, -2 is 3; digits 1 2 (2|8) 1 3.
    data = np.array([3, 1, 0x12A13000], "<u4").tobytes()
    np.testing.assert_array_equal(decode_rvl(data, (3, 1), where="here"), [[0, 5, 3]])


def test_png_and_inverse_depth() -> None:
    depth = some_depth()
    size = (17, 12)
    for name in ("16UC1", "16UC1; compressedDepth", "mono16; compressedDepth png"):
        found = decode_compressed_depth(HEADER + png(depth), name, size, where="here")
        np.testing.assert_array_equal(found, depth)
    header = np.int32(0).tobytes() + np.float32([1000, -50]).tobytes()
    found = decode_compressed_depth(
        header + png(depth), "32FC1; compressedDepth png", size, where=""
    )
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found == 0, depth == 0)
    np.testing.assert_allclose(found[depth > 0], 1000 / (depth[depth > 0] + 50.0), rtol=1e-6)


@pytest.mark.parametrize(
    ("data", "name", "message"),
    [
        (HEADER[:5], "16UC1; compressedDepth png", "cut short"),
        (HEADER + png(some_depth())[:-9], "16UC1; compressedDepth png", "no whole PNG"),
        (HEADER + png(some_depth().astype(np.uint8)), "16UC1", "no whole PNG of 16 bits"),
        (HEADER + png(some_depth()[1:]), "16UC1", "is 17x11, its camera 17x12"),
        (HEADER + png(some_depth()), "16UC1; compressedDepth zstd", "is not known"),
        (HEADER + png(some_depth()), "8UC1; compressedDepth png", "is not known"),
        (HEADER + rvl(some_depth())[:-8], "16UC1; compressedDepth rvl", "is damaged"),
        (HEADER + rvl(some_depth()[1:]), "16UC1; compressedDepth rvl", "17x11"),
        (HEADER + b"\0", "16UC1; compressedDepth rvl", "cut short"),
        (HEADER + bytes(8), "16UC1; compressedDepth rvl", "0x0"),
    ],
)
def test_what_is_wrong_is_said(data: bytes, name: str, message: str) -> None:
    with pytest.raises(ProgroundError, match=message) as caught:
        decode_compressed_depth(data, name, (17, 12), where="bag, /depth")
    assert caught.value.where == "bag, /depth"


@pytest.mark.parametrize("coding", ["png", "rvl"])
def test_damaged_bytes_give_an_error_or_an_image(coding: str) -> None:
    rng = np.random.default_rng(5)
    whole = HEADER + (rvl if coding == "rvl" else png)(some_depth())
    for _ in range(300):
        data = bytearray(whole[: rng.integers(1, len(whole) + 1)])
        for at in rng.integers(0, len(data), 3):
            data[at] ^= 1 << rng.integers(8)
        for kind in ("16UC1", "32FC1"):
            name = f"{kind}; compressedDepth {coding}"
            try:
                depth = decode_compressed_depth(bytes(data), name, (17, 12), where="here")
            except ProgroundError:
                continue
            assert depth.shape == (12, 17)
            assert np.isfinite(depth).all()
