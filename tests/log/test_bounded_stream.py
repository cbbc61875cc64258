from __future__ import annotations

import io
import tracemalloc
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.exceptions import McapError

from proground_log.errors import ProgroundError
from proground_log.log.bounded_stream import LARGEST_CHUNK_BYTES, BoundedStream
from proground_log.log.checking.check import check_log
from proground_log.log.reader import LogReader
from tests.fuzz.mcap_records import with_first_chunk
from tests.writers.small_source import SmallSource, write_log


def test_it_reads_as_the_stream_does() -> None:
    stream = BoundedStream(io.BytesIO(b"0123456789"))
    assert (stream.read(3), stream.tell(), stream.seekable()) == (b"012", 3, True)
    assert (stream.seek(-2, io.SEEK_END), stream.read()) == (8, b"89")
    assert (stream.seek(20), stream.read(4)) == (20, b"")


def test_it_never_asks_for_more_than_there_is(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(bytes(100))
    tracemalloc.start()
    with path.open("rb") as file:
        assert len(BoundedStream(file).read(2**40)) == 100
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()


@pytest.mark.parametrize("offset", [-1, 2**63, 2**64 - 1])
def test_it_goes_to_no_place_that_cannot_be(tmp_path: Path, offset: int) -> None:
    path = tmp_path / "a"
    path.write_bytes(bytes(100))
    with path.open("rb") as file, pytest.raises(McapError, match=f"there is no byte {offset}"):
        BoundedStream(file).seek(offset)


def bomb(size: int, *, announced: bool = True) -> bytes:
    packer = zstandard.ZstdCompressor().compressobj(*[size] * announced)
    pieces = [packer.compress(bytes(2**20)) for _ in range(size // 2**20)]
    return b"".join([*pieces, packer.flush()])


@pytest.mark.parametrize(
    "data",
    [
        bomb(LARGEST_CHUNK_BYTES + 2**20),
        bomb(2**20, announced=False),
        lz4.frame.compress(bytes(100)),
    ],
    ids=["large", "unannounced", "lz4"],
)
def test_a_chunk_that_could_fill_the_memory_is_refused(tmp_path: Path, data: bytes) -> None:
    with pytest.raises(McapError, match="unpacks to"):
        BoundedStream(io.BytesIO(data)).read(len(data))
    log = write_log(tmp_path / "a.mcap", SmallSource(2))
    log.write_bytes(with_first_chunk(log.read_bytes(), data))
    with pytest.raises(ProgroundError, match=r"a\.mcap: the file is damaged .*unpacks to"):
        list(LogReader(log).frames())
    assert "unpacks to" in " ".join(fault.what for fault in check_log(log, lambda *_: None))
