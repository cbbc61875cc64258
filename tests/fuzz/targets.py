"""What is fuzzed: which valid inputs there are, what is changed in them, how they are read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mcap.writer import CompressionType

from proground_log.evaluation.label_lists import read_labelled_mesh
from proground_log.log.checking.check import check_log
from proground_log.log.info import log_info
from proground_log.log.reader import LogReader
from recorders.formats.colmap.source import ColmapSource
from recorders.recover import recover
from recorders.registry import FORMATS
from recorders.source import Source
from tests.fuzz import inputs
from tests.fuzz.containers import of_png, of_records, of_sens, of_zip
from tests.fuzz.mcap_records import of_mcap
from tests.fuzz.mutations import Mutator, of_bytes, of_words
from tests.writers.colmap import METRES_PER_UNIT, write_binary, write_text
from tests.writers.tum import CALIBRATION


@dataclass(frozen=True)
class Target:
    """Something that reads hostile input.

    Args:
        inputs: each writes a valid input into an empty folder and returns what is to be read.
        read: reads an input to its end; what it writes, it writes into the folder beside, which
            for most stays empty.
        changed: patterns of the files to change, and how.
        asks_freely: its library asks for as much memory as a number in the file says, and only
            then reads, which fills none of it: to be refused that is an error like any other.
    """

    inputs: tuple[Callable[[Path], Path], ...]
    read: Callable[[Path, Path], object]
    changed: dict[str, tuple[Mutator, ...]]
    asks_freely: bool = False


def _recorded(name: str, **options: object) -> Callable[[Path, Path], object]:
    """Reads a data set as `pglog record` does, every frame."""

    def read(source: Path, _: Path) -> object:
        FORMATS[name].recognise(source)
        return _to_the_end(FORMATS[name].opener()(source, **options))

    return read


def _to_the_end(source: Source) -> object:
    for index in range(len(source)):
        frame = source.frame(index)
        frame.decode_color()
    return source.ground_truth_mesh()


def _read_colmap(source: Path, _: Path) -> object:
    return _to_the_end(ColmapSource(source, scale=METRES_PER_UNIT))


def _read_log(log: Path, _: Path) -> object:
    log_info(log)
    frames = list(LogReader(log).frames())
    for frame in frames:
        frame.decode_color()
    return frames


def _check_log(log: Path, _: Path) -> object:
    return check_log(log, lambda *_: None)


def _recover(log: Path, out: Path) -> object:
    """What is recovered has to be a log whose every frame can be read."""
    saved = out / "saved.mcap"
    recovery = recover(log, saved, overwrite=False, progress=lambda *_: None)
    count = sum(1 for _ in LogReader(saved).frames())
    assert count == recovery.frames, f"{count} frames, not the {recovery.frames} that were saved"
    return recovery


_RVL, _PNG = "32FC1; compressedDepth rvl", "16UC1; compressedDepth png"

TARGETS = {
    "sens": Target(
        tuple(inputs.sens(codings) for codings in ((2, 1), (0, 0), (1, 1))),
        _recorded("scannet-sens"),
        {"*.sens": (of_bytes, of_sens)},
    ),
    "r3d": Target((inputs.r3d,), _recorded("record3d"), {"*.r3d": (of_bytes, of_zip, of_zip)}),
    "scannetpp-depth": Target(
        tuple(map(inputs.iphone, ("lz4", "deflate"))),
        _recorded("scannetpp"),
        {"depth.bin": (of_bytes, of_records)},
    ),
    "scannetpp-stream": Target(
        (inputs.iphone("one stream"),),
        _recorded("scannetpp"),
        {"depth.bin": (of_bytes,), "*.json": (of_words,)},
    ),
    "colmap-binary": Target(
        (inputs.workspace(write_binary),), _read_colmap, {"sparse/*.bin": (of_bytes,)}
    ),
    "colmap-text": Target(
        (inputs.workspace(write_text),), _read_colmap, {"sparse/*.txt": (of_words,)}
    ),
    "colmap-depth": Target(
        (inputs.workspace(write_binary),),
        _read_colmap,
        {"stereo/depth_maps/*.bin": (of_bytes, of_words)},
    ),
    "ply": Target(
        tuple(map(inputs.mesh, ("binary_little_endian", "binary_big_endian", "ascii"))),
        lambda mesh, _: read_labelled_mesh(mesh.read_bytes(), where=mesh),
        {"*.ply": (of_bytes, of_words)},
    ),
    "log": Target((inputs.log,), _read_log, {"*.mcap": (of_bytes, of_mcap)}),
    "check": Target((inputs.log,), _check_log, {"*.mcap": (of_bytes, of_mcap)}),
    "recover": Target((inputs.log,), _recover, {"*.mcap": (of_bytes, of_mcap)}),
    "ros2-bag": Target(
        (
            inputs.bag("16UC1", "jpeg", CompressionType.ZSTD),
            inputs.bag("32FC1", "rgb8", CompressionType.LZ4),
            inputs.bag("png", "bgra8", CompressionType.NONE),
        ),
        _recorded("ros2-bag"),
        {"*.mcap": (of_bytes, of_mcap)},
    ),
    "compressed-depth": Target(
        tuple(inputs.bag(depth, "jpeg", CompressionType.NONE) for depth in (_RVL, _PNG)),
        _recorded("ros2-bag"),
        {"*.mcap": (of_mcap,)},
    ),
    "ros1-bag": Target(
        tuple(map(inputs.old_bag, (None, "BZ2", "LZ4"))),
        _recorded("ros1-bag"),
        {"*.bag": (of_bytes,)},
        asks_freely=True,
    ),
    "npy": Target(
        (inputs.depth_npy,), _recorded("nerfstudio"), {"depths/*.npy": (of_bytes, of_words)}
    ),
    "images": Target(
        (inputs.redwood_folder,),
        _recorded("redwood"),
        {"color/*.jpg": (of_bytes,), "depth/*.png": (of_bytes, of_png)},
    ),
    "transforms": Target((inputs.transforms,), _recorded("nerfstudio"), {"*.json": (of_words,)}),
    "tum": Target(
        (inputs.tum_folder,),
        _recorded("tum", calibration=CALIBRATION),
        {"*.txt": (of_words,), "depth/*.png": (of_png,), "rgb/*.png": (of_png,)},
    ),
    "redwood": Target(
        (inputs.redwood_folder,),
        _recorded("redwood"),
        {"*.log": (of_words,), "*.json": (of_words,)},
    ),
    "arkitscenes": Target(
        (inputs.arkitscenes_video,),
        _recorded("arkitscenes"),
        {
            "*.traj": (of_words,),
            "lowres_wide_intrinsics/*.pincam": (of_words,),
            "confidence/*.png": (of_png,),
        },
    ),
}
