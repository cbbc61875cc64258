from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pglog.commands import main
from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError
from proground_log.frame import Selection
from proground_log.log.reader import LogReader
from proground_log.log.sheet import MAP_AXES, draw_sheet, map_axes
from proground_log.palette import label_colors
from recorders.record import record
from tests.writers.small_source import SmallSource, write_log

pytestmark = pytest.mark.slow


def drawn(log: Path, output: Path) -> np.ndarray:
    """The sheet of a log, uint8 [H, W, 3] RGB."""
    draw_sheet(log, output, overwrite=False)
    return cv2.cvtColor(cv2.imread(str(output)), cv2.COLOR_BGR2RGB)


def share(picture: np.ndarray, color: np.ndarray) -> float:
    """Share of pixels of about this colour."""
    return float((np.abs(picture.astype(int) - color).max(axis=-1) <= 2).mean())


def test_the_same_log_gives_the_same_picture(room_log: Path, tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        draw_sheet(room_log, tmp_path / name, overwrite=False)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"a.png", "b.png"}


def test_frames_and_labels_are_on_it(room_log: Path, tmp_path: Path) -> None:
    picture = drawn(room_log, tmp_path / "a.png")
    for frame in LogReader(room_log).frames([0, 11]):
        small = cv2.resize(frame.decode_color(), None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)
        match = cv2.matchTemplate(picture, small, cv2.TM_CCOEFF_NORMED)
        assert match.max() > 0.9
        assert frame.labels is not None
        label = np.bincount(frame.labels.ravel()).argmax()
        assert share(picture, label_colors(int(label) + 1)[label]) > 0.01


def test_a_sheet_without_labels_is_smaller(tmp_path: Path) -> None:
    heights = []
    for with_labels in (False, True):
        log = write_log(tmp_path / f"{with_labels}.mcap", SmallSource(12, with_labels=with_labels))
        heights.append(drawn(log, tmp_path / f"{with_labels}.png").shape[0])
    assert heights[0] < heights[1]


def test_depth_has_one_scale_in_all_frames(tmp_path: Path) -> None:
    source = SmallSource(3)
    near, far = (np.full((24, 32), depth_mm, np.uint16) for depth_mm in (1000, 3000))
    half = np.where(np.arange(32) < 16, near, far)
    cells = {"far": (near, far, near), "half": (near, far, half)}
    shares = {}
    for name, depths in cells.items():
        frames = [replace(source.frame(i), depth=depth) for i, depth in enumerate(depths)]
        log = write_log(tmp_path / f"{name}.mcap", source, frames=frames)
        picture = drawn(log, tmp_path / f"{name}.png")
        dark_red, dark_blue = np.array([122, 4, 2]), np.array([48, 18, 59])
        shares[name] = share(picture, dark_red), share(picture, dark_blue)
    assert shares["far"][0] / shares["far"][1] == pytest.approx(2, rel=0.1)
    assert shares["half"][0] / shares["half"][1] == pytest.approx(1, rel=0.1)


def odd_sources() -> Iterator[tuple[str, SmallSource]]:
    yield "one frame", SmallSource(1, with_labels=True)
    tall = Camera(24, 64, 30.0, 30.0, 12.0, 32.0)
    yield "tall, in metres", SmallSource(2, Calibration.registered(tall), in_metres=True)
    beside = np.eye(4)
    beside[0, 3] = 0.025
    wide = Camera(64, 20, 30.0, 30.0, 32.0, 10.0)
    yield "two cameras", SmallSource(14, Calibration(wide, tall, beside), with_labels=True)


@pytest.mark.parametrize(("what", "source"), list(odd_sources()))
def test_odd_recordings_are_drawn(what: str, source: SmallSource, tmp_path: Path) -> None:
    log = write_log(tmp_path / "a.mcap", source)
    assert drawn(log, tmp_path / "a.png").std() > 10, what


def test_a_recording_that_stands_still_without_depth_is_drawn(tmp_path: Path) -> None:
    source = SmallSource(2)
    frame = replace(source.frame(0), depth=np.zeros((24, 32), np.uint16))
    frames = [frame, replace(frame, index=1, stamp_ns=frame.stamp_ns + 1)]
    assert drawn(write_log(tmp_path / "a.mcap", source, frames=frames), tmp_path / "a.png").any()


class NamedSource(SmallSource):
    """Classes with names that are no formulas, and not in every font."""

    @property
    def label_names(self) -> dict[int, str]:
        return {1: r"$\foo$", 2: "字", 40: "a_$"}


def test_names_are_drawn_as_they_are(tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    source = NamedSource(2, with_labels=True)
    record(source, r"$\foo$ 字", log, Selection(), overwrite=False, progress=lambda *_: None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert drawn(log, tmp_path / "a.png").any()


def test_maps_are_seen_from_above_and_not_mirrored() -> None:
    axes = np.eye(3)
    for (up, sign), (right, ahead) in MAP_AXES.items():
        np.testing.assert_array_equal(np.cross(axes[right], axes[ahead]), sign * axes[up])


@pytest.mark.parametrize("down_deg", [-20, 0, 30, 60])
@pytest.mark.parametrize("expected", MAP_AXES.values())
def test_up_is_found_where_the_camera_looks_at_a_table(
    down_deg: float, expected: tuple[int, int]
) -> None:
    """A camera that looks along the first axis of the map and down."""
    ahead, left = np.eye(3)[list(expected)]
    world_from_level = np.stack([-left, -np.cross(ahead, left), ahead], axis=1)
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, :3] = (
        world_from_level @ Rotation.from_euler("x", -down_deg, degrees=True).as_matrix()
    )
    assert map_axes(poses) == expected


def test_a_picture_is_replaced_only_when_asked(tmp_path: Path) -> None:
    log, output = write_log(tmp_path / "a.mcap"), tmp_path / "a.png"
    output.write_bytes(b"mine")
    with pytest.raises(ProgroundError, match=r"a\.png: the output exists"):
        draw_sheet(log, output, overwrite=False)
    assert output.read_bytes() == b"mine"
    draw_sheet(log, output, overwrite=True)
    assert output.read_bytes().startswith(b"\x89PNG")


def test_what_is_no_log_leaves_no_picture(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"no log")
    with pytest.raises(ProgroundError, match=r"a\.mcap: is no MCAP file"):
        draw_sheet(tmp_path / "a.mcap", tmp_path / "a.png", overwrite=False)
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_info_draws_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    log, output = write_log(tmp_path / "a.mcap"), tmp_path / "sheet.png"
    command = ["pglog", "info", str(log), "--sheet", str(output)]
    for extra, code in (([], 0), ([], 2), (["--overwrite", "--json"], 0)):
        monkeypatch.setattr(sys, "argv", [*command, *extra])
        with pytest.raises(SystemExit) as stop:
            main()
        assert stop.value.code == code
    assert output.is_file()
    assert "sheet.png: the output exists" in capsys.readouterr().err
