from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from PIL import Image

from proground_log.camera import Camera
from proground_log.errors import ProgroundError
from recorders.reading.images import (
    numbered_files,
    read_color,
    read_depth,
    read_encoded,
    read_labels,
)

CAMERA = Camera(32, 24, 30.0, 30.0, 16.0, 12.0)
DEPTH = np.random.default_rng(0).integers(0, 65536, (24, 32), dtype=np.uint16)
COLOR = np.random.default_rng(1).integers(0, 256, (24, 32, 3), dtype=np.uint8)


def encoded(pixels: np.ndarray, suffix: str) -> bytes:
    return cv2.imencode(suffix, pixels)[1].tobytes()


def with_thumbnail() -> bytes:
    """A JPEG with a whole JPEG in its EXIF, as cameras write them: two end markers."""
    exif = Image.Exif()
    exif[0x927C] = encoded(COLOR[:8, :8], ".jpg")
    buffer = io.BytesIO()
    Image.fromarray(COLOR).save(buffer, "jpeg", exif=exif)
    return buffer.getvalue()


@pytest.mark.parametrize(("suffix", "kind"), [(".jpg", "jpeg"), (".png", "png")])
@pytest.mark.parametrize("padding", [b"", b"\0" * 5000, b"\r\n"])
def test_color_keeps_its_bytes(tmp_path: Path, suffix: str, kind: str, padding: bytes) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(encoded(COLOR, suffix) + padding)
    image = read_color(path, CAMERA)
    assert image.data == path.read_bytes()
    assert (image.format, image.width, image.height) == (kind, 32, 24)


@pytest.mark.parametrize("suffix", [".jpg", ".png", "exif"])
@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@example(kept=np.nextafter(1, 0), zeros=True)
@given(kept=st.floats(0, 1, exclude_max=True), zeros=st.booleans())
def test_color_cut_anywhere_is_refused(
    tmp_path: Path, suffix: str, kept: float, zeros: bool
) -> None:
    whole = with_thumbnail() if suffix == "exif" else encoded(COLOR, suffix)
    cut = whole[: int(kept * len(whole))]
    # A crash while writing often leaves the file's full length, with zeros at its end.
    path = tmp_path / "cut"
    path.write_bytes(cut + b"\0" * (len(whole) - len(cut)) * zeros)
    with pytest.raises(ProgroundError, match="cut"):
        read_encoded(path)


def test_whole_color_with_a_thumbnail_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    path.write_bytes(with_thumbnail())
    assert read_encoded(path).width == 32


def test_color_cut_behind_its_thumbnail_is_refused(tmp_path: Path) -> None:
    whole = with_thumbnail()
    path = tmp_path / "a.jpg"
    path.write_bytes(whole[: whole.index(b"\xff\xd9") + 200])
    with pytest.raises(ProgroundError, match=r"cut short|not a readable image"):
        read_encoded(path)


@pytest.mark.parametrize("suffix", [".bmp", ".webp"])
def test_other_color_formats_are_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(encoded(COLOR, suffix))
    with pytest.raises(ProgroundError, match="convert the images to JPEG or PNG"):
        read_encoded(path)


def test_depth_comes_back_exactly(tmp_path: Path) -> None:
    path = tmp_path / "depth.png"
    path.write_bytes(encoded(DEPTH, ".png") + b"\0" * 7)
    depth = read_depth(path, CAMERA)
    assert depth.dtype == np.uint16
    np.testing.assert_array_equal(depth, DEPTH)


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(kept=st.floats(0, 1, exclude_max=True))
def test_depth_cut_anywhere_is_refused(tmp_path: Path, kept: float) -> None:
    whole = encoded(DEPTH, ".png")
    path = tmp_path / "depth.png"
    path.write_bytes(whole[: int(kept * len(whole))])
    with pytest.raises(ProgroundError, match=r"depth\.png"):
        read_depth(path, CAMERA)


def test_depth_broken_inside_is_refused(tmp_path: Path) -> None:
    whole = bytearray(encoded(DEPTH, ".png"))
    middle = len(whole) // 2
    whole[middle : middle + 200] = bytes(200)
    path = tmp_path / "depth.png"
    path.write_bytes(whole)
    with pytest.raises(ProgroundError, match=r"depth\.png: the PNG image cannot be decoded"):
        read_depth(path, CAMERA)


@pytest.mark.parametrize(
    ("pixels", "message"),
    [
        (DEPTH.astype(np.uint8), "8 bits, 1 channel"),
        (np.dstack([DEPTH] * 3), "16 bits, 3 channel"),
        (DEPTH[:, :30], "is 30x24, but the calibration is for 32x24"),
    ],
)
def test_wrong_depth_is_refused(tmp_path: Path, pixels: np.ndarray, message: str) -> None:
    path = tmp_path / "depth.png"
    path.write_bytes(encoded(pixels, ".png"))
    with pytest.raises(ProgroundError, match=message) as caught:
        read_depth(path, CAMERA)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("read", [read_depth, read_labels])
def test_no_room_is_made_for_a_size_that_the_camera_has_not(tmp_path: Path, read: Any) -> None:
    data = bytearray(encoded(DEPTH, ".png"))
    data[16:24] = struct.pack(">II", 40_000, 20_000)
    data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
    path = tmp_path / "a.png"
    path.write_bytes(data)
    with pytest.raises(ProgroundError, match="is 40000x20000, but the calibration is for 32x24"):
        read(path, CAMERA)


@pytest.mark.parametrize("read", [read_color, read_depth])
def test_no_room_is_made_for_a_chunk_that_the_file_has_not(tmp_path: Path, read: Any) -> None:
    data = bytearray(encoded(DEPTH, ".png"))
    data[33:37] = struct.pack(">I", 2**30)
    path = tmp_path / "a.png"
    path.write_bytes(data)
    with pytest.raises(ProgroundError, match=r"a\.png: .*(whole PNG|cut short)"):
        read(path, CAMERA)


def test_depth_that_is_no_png_but_ends_as_one(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(encoded(DEPTH, ".tiff") + encoded(DEPTH, ".png")[-12:])
    with pytest.raises(ProgroundError, match=r"a\.png: is not a whole PNG image"):
        read_depth(path, CAMERA)


def test_an_image_whose_header_is_too_short_is_refused(tmp_path: Path) -> None:
    content = b"IHDR" + bytes(5)
    chunk = struct.pack(">I", 5) + content + zlib.crc32(content).to_bytes(4, "big")
    whole = encoded(COLOR, ".png")
    path = tmp_path / "a.png"
    path.write_bytes(whole[:8] + chunk + whole[33:])
    with pytest.raises(ProgroundError, match=r"a\.png: is not a readable image"):
        read_encoded(path)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_labels_come_back_as_16_bits(tmp_path: Path, kind: type) -> None:
    path = tmp_path / "labels.png"
    path.write_bytes(encoded(DEPTH.astype(kind), ".png"))
    labels = read_labels(path, CAMERA)
    assert labels.dtype == np.uint16
    np.testing.assert_array_equal(labels, DEPTH.astype(kind))


def test_colored_labels_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "labels.png"
    path.write_bytes(encoded(COLOR, ".png"))
    with pytest.raises(ProgroundError, match="3 channels"):
        read_labels(path, CAMERA)


@pytest.mark.parametrize("read", [read_color, read_depth, read_labels])
def test_missing_image_is_named(tmp_path: Path, read: object) -> None:
    with pytest.raises(ProgroundError, match=r"gone\.png: no such file"):
        read(tmp_path / "gone.png", CAMERA)  # type: ignore[operator]


def test_files_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for number in (10, 9, 100, 2):
        (tmp_path / f"a{number}.png").touch()
    (tmp_path / "a3.png.bak").touch()
    assert list(numbered_files(tmp_path, r"a(\d+)\.png")) == [2, 9, 10, 100]


def test_two_files_of_one_number_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a1.jpg").touch()
    (tmp_path / "a01.png").touch()
    with pytest.raises(ProgroundError, match=r"a1\.jpg: has the same number as a01\.png"):
        numbered_files(tmp_path, r"a(\d+)\.(?:png|jpg)")


def test_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(ProgroundError, match="gone: no such folder"):
        numbered_files(tmp_path / "gone", r"(\d+)")
