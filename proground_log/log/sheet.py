"""A contact sheet of a log: some of its frames, and its way from above, as one picture."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from proground_log.camera import Calibration, transform
from proground_log.files import require_free, written_whole
from proground_log.frame import SensorFrame, evenly
from proground_log.log.info import LogInfo, log_info
from proground_log.log.reader import LogReader
from proground_log.log.upright import nearest_axis, up_direction
from proground_log.palette import label_colors

MOST_FRAMES, MOST_POSES = 12, 300
MOST_CLASSES = 14
"""In the legend: those that cover most of the frames shown."""
THUMBNAIL_WIDTH = 240
POINTS_WIDTH = 100
"""Columns of a depth image that the map shows."""
DEPTH_COLORS = colormaps["turbo_r"].with_extremes(bad="#bbbbbb")

# Sizes in inches.
DPI = 110
COLUMNS, IMAGE_WIDTH, TALLEST_IMAGE, COLUMN_GAP = 6, 1.75, 2.4, 0.16
GAP, CAPTION, MARGIN, HEADER = 0.06, 0.28, 0.3, 0.8
SIDE_WIDTH, MAP_HEIGHT, SCALE_HEIGHT, LEGEND_HEIGHT = 4.6, 4.4, 0.15, 1.6

MAP_AXES = {(0, 1): (1, 2), (0, -1): (2, 1), (1, 1): (2, 0), (1, -1): (0, 2)}
MAP_AXES |= {(2, 1): (0, 1), (2, -1): (1, 0)}
"""By the world's axis that points up, and its sign: see `map_axes`."""


@dataclass(frozen=True)
class _Thumbnail:
    """A frame as the sheet shows it.

    Args:
        index, stamp_ns: its number and time.
        color: uint8 [h, w, 3] RGB.
        depth_m: float32 [h, w] metres, nan where nothing was measured.
        labels: uint16 [h, w], 0 = none, or None.
        points_m: some of the surface that it saw, world axes, [N, 3].
    """

    index: int
    stamp_ns: int
    color: np.ndarray
    depth_m: np.ndarray
    labels: np.ndarray | None
    points_m: np.ndarray


def draw_sheet(path: Path, output: Path, *, overwrite: bool) -> None:
    """Draw a contact sheet of a log; the same log gives the same picture.

    Args:
        path: the log.
        output: the picture (PNG).
        overwrite: replace a picture that is there.

    Raises:
        ProgroundError: the log is none or is damaged, or the picture cannot be written.
    """
    require_free(output, overwrite=overwrite)
    reader = LogReader(path)
    thumbnails, poses = _read(reader)
    figure = _draw(log_info(path), reader.label_names, thumbnails, poses)
    with written_whole(output) as temporary, warnings.catch_warnings():
        # A name in letters that the font lacks is drawn as boxes.
        warnings.filterwarnings("ignore", "Glyph .* missing")
        figure.savefig(temporary, format="png", dpi=DPI, metadata={"Software": None})


def _read(reader: LogReader) -> tuple[list[_Thumbnail], np.ndarray]:
    """Thumbnails of frames spread over the recording, and poses [P, 4, 4] of some more."""
    shown, known = (evenly(len(reader), count) for count in (MOST_FRAMES, MOST_POSES))
    thumbnails, poses = [], []
    for frame in reader.frames(sorted({*shown, *known})):
        poses.append(frame.world_from_camera)
        if frame.index in shown:
            thumbnails.append(_thumbnail(frame, frame.calibration or reader.calibration))
    return thumbnails, np.array(poses)


def _thumbnail(frame: SensorFrame, calibration: Calibration) -> _Thumbnail:
    color = frame.decode_color()
    height, width = color.shape[:2]
    size = THUMBNAIL_WIDTH, max(1, round(height * THUMBNAIL_WIDTH / width))
    depth_m = frame.depth_m
    step = _step(depth_m, POINTS_WIDTH)
    points = calibration.depth.unproject(depth_m)[::step, ::step][depth_m[::step, ::step] > 0]
    return _Thumbnail(
        index=frame.index,
        stamp_ns=frame.stamp_ns,
        color=cv2.resize(color, size, interpolation=cv2.INTER_AREA),
        depth_m=_thinned(np.where(depth_m > 0, depth_m, np.float32(np.nan))),
        labels=None if frame.labels is None else _thinned(frame.labels),
        points_m=transform(frame.world_from_camera, points.astype(np.float64)),
    )


def _step(image: np.ndarray, width: int) -> int:
    return max(1, image.shape[1] // width)


def _thinned(image: np.ndarray) -> np.ndarray:
    """Every so many-th pixel: depth and labels have no mean."""
    step = _step(image, THUMBNAIL_WIDTH)
    return image[::step, ::step].copy()


class _Sheet:
    """A figure on which places are counted in inches from the top left corner."""

    def __init__(self, width: float, height: float) -> None:
        self.figure = Figure(figsize=(width, height), facecolor="white")
        self._width, self._height = width, height

    def axes(self, x: float, y: float, width: float, height: float) -> Axes:
        bottom = 1 - (y + height) / self._height
        box = (x / self._width, bottom, width / self._width, height / self._height)
        return self.figure.add_axes(box)

    def image(self, x: float, y: float, height: float) -> Axes:
        axes = self.axes(x, y, IMAGE_WIDTH, height)
        axes.set_axis_off()
        return axes

    def text(self, x: float, y: float, text: str, **style: object) -> None:
        # Names come from the log: a $ in them begins no formula.
        place = x / self._width, 1 - y / self._height
        self.figure.text(*place, text, va="center", parse_math=False, **style)  # type: ignore[arg-type]


def _draw(
    info: LogInfo, names: dict[int, str], thumbnails: Sequence[_Thumbnail], poses: np.ndarray
) -> Figure:
    has_labels = any(thumbnail.labels is not None for thumbnail in thumbnails)
    color_height = max(_height(thumbnail.color) for thumbnail in thumbnails)
    depth_height = max(_height(thumbnail.depth_m) for thumbnail in thumbnails)
    heights = [color_height, depth_height] + [color_height] * has_labels
    block = CAPTION + sum(heights) + GAP * len(heights)
    columns = min(COLUMNS, len(thumbnails))
    rows = -(-len(thumbnails) // columns)
    side = 3 * MARGIN + columns * (IMAGE_WIDTH + COLUMN_GAP)
    scale_top = HEADER + MAP_HEIGHT + 0.65
    legend_top = scale_top + SCALE_HEIGHT + 0.6
    sheet = _Sheet(
        width=side + SIDE_WIDTH + MARGIN,
        height=MARGIN + max(HEADER + rows * block, legend_top + LEGEND_HEIGHT * has_labels),
    )
    sheet.text(MARGIN, 0.3, f"{info.source} ({info.format})", size=15, weight="bold")
    sheet.text(MARGIN, 0.58, _summary(info), size=10, color="#444444")

    depths_m = np.concatenate([thumbnail.depth_m.ravel() for thumbnail in thumbnails])
    depths_m = depths_m[np.isfinite(depths_m)]
    nearest_m, farthest_m = np.percentile(depths_m, (1, 99)) if depths_m.size else (0.0, 1.0)
    for place, thumbnail in enumerate(thumbnails):
        row, column = divmod(place, columns)
        x, y = MARGIN + column * (IMAGE_WIDTH + COLUMN_GAP), HEADER + row * block
        seconds = (thumbnail.stamp_ns - thumbnails[0].stamp_ns) / 1e9
        sheet.text(x, y + CAPTION / 2, f"frame {thumbnail.index}", size=9, weight="bold")
        sheet.text(x + IMAGE_WIDTH, y + CAPTION / 2, f"{seconds:.2f} s", size=9, ha="right")
        y += CAPTION
        sheet.image(x, y, color_height).imshow(thumbnail.color)
        y += color_height + GAP
        depth = sheet.image(x, y, depth_height).imshow(
            thumbnail.depth_m, cmap=DEPTH_COLORS, vmin=nearest_m, vmax=farthest_m
        )
        y += depth_height + GAP
        if thumbnail.labels is not None:
            colors = label_colors(int(thumbnail.labels.max()) + 1)
            sheet.image(x, y, color_height).imshow(colors[thumbnail.labels])

    _draw_map(sheet.axes(side, HEADER + 0.1, SIDE_WIDTH, MAP_HEIGHT), info, thumbnails, poses)
    scale = sheet.axes(side, scale_top, SIDE_WIDTH, SCALE_HEIGHT)
    sheet.figure.colorbar(depth, cax=scale, orientation="horizontal", extend="neither")
    scale.set_xlabel("depth (m); grey where nothing was measured")
    if has_labels:
        _draw_legend(sheet.axes(side, legend_top, SIDE_WIDTH, LEGEND_HEIGHT), names, thumbnails)
    return sheet.figure


def _height(image: np.ndarray) -> float:
    return min(TALLEST_IMAGE, IMAGE_WIDTH * image.shape[0] / image.shape[1])


def _count(number: int, one: str, many: str) -> str:
    return f"{number} {one if number == 1 else many}"


def _summary(info: LogInfo) -> str:
    sizes_m = np.subtract(info.bounds_upper_m, info.bounds_lower_m)
    color, depth = info.color_camera, info.depth_camera
    return ",  ".join(
        [
            f"{_count(info.frames, 'frame', 'frames')} in {info.duration_s:.2f} s",
            f"box {' × '.join(f'{size:.1f}' for size in sizes_m)} m",
            f"colour {color['width']}×{color['height']}",
            f"depth {depth['width']}×{depth['height']}",
            *[_count(len(info.labels), "class", "classes")] * bool(info.labels),
        ]
    )


def map_axes(poses: np.ndarray) -> tuple[int, int]:
    """The world's axes to the right and up on a map seen from above, so that nothing is mirrored.

    Args:
        poses: world_from_camera, [P, 4, 4], camera axes x right, y down, z forward.
    """
    return MAP_AXES[nearest_axis(up_direction(poses))]


def _draw_map(
    axes: Axes, info: LogInfo, thumbnails: Sequence[_Thumbnail], poses: np.ndarray
) -> None:
    """The way of the camera from above, over the surface that the frames shown saw."""
    right, ahead = map_axes(poses)
    surface_m = np.concatenate([thumbnail.points_m for thumbnail in thumbnails])
    axes.plot(surface_m[:, right], surface_m[:, ahead], ",", color="#999999", alpha=0.6)
    lower_m, upper_m = np.array(info.bounds_lower_m), np.array(info.bounds_upper_m)
    corner, (width, height) = lower_m[[right, ahead]], (upper_m - lower_m)[[right, ahead]]
    box = Rectangle((corner[0], corner[1]), width, height, fill=False, ls="--", ec="#888888")
    axes.add_patch(box).set_label("box")
    x, y = poses[:, right, 3], poses[:, ahead, 3]
    axes.plot(x, y, color="#1f5fbf", lw=1.5, label="camera")
    axes.plot(x[0], y[0], "o", color="#18a018", ms=9, label="start")
    axes.plot(x[-1], y[-1], "s", color="#c02020", ms=7, label="end")
    arrows = evenly(len(poses), 24)
    axes.quiver(
        x[arrows], y[arrows], poses[arrows, right, 2], poses[arrows, ahead, 2],
        color="#1f5fbf", width=0.003, scale=18, zorder=3,
    )  # fmt: skip
    seen = np.stack([x, y], axis=1)
    low = np.minimum(corner, seen.min(axis=0))
    high = np.maximum(upper_m[[right, ahead]], seen.max(axis=0))
    m_per_inch = 1.1 * max((high - low) / (SIDE_WIDTH, MAP_HEIGHT))
    middle, half = (low + high) / 2, m_per_inch * np.array([SIDE_WIDTH, MAP_HEIGHT]) / 2
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
    axes.set_xlabel(f"{'xyz'[right]} (m)")
    axes.set_ylabel(f"{'xyz'[ahead]} (m)")
    axes.set_title("from above", size=10, loc="left")
    above = (1, 1)
    axes.legend(loc="lower right", bbox_to_anchor=above, ncols=4, fontsize=8, frameon=False)


def _draw_legend(axes: Axes, names: dict[int, str], thumbnails: Sequence[_Thumbnail]) -> None:
    """The classes that cover most of the frames shown, in their colours."""
    labels = [thumbnail.labels.ravel() for thumbnail in thumbnails if thumbnail.labels is not None]
    found, counts = np.unique(np.concatenate(labels), return_counts=True)
    order = np.argsort(-counts[found > 0], kind="stable")
    largest = [int(label) for label in found[found > 0][order][:MOST_CLASSES]]
    colors = label_colors(int(found.max()) + 1) / 255
    patches = [
        Patch(color=colors[each], label=names.get(each, f"class {each}")) for each in largest
    ]
    legend = axes.legend(
        handles=patches, loc="upper left", ncols=2, fontsize=8, frameon=False, borderaxespad=0
    )
    for text in legend.get_texts():
        text.set_parse_math(False)
    axes.set_axis_off()
