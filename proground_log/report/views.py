"""The page's pictures: what the sensor saw, beside what the map shows from there."""

from __future__ import annotations

import numpy as np

from proground_log.events import ViewRendered
from proground_log.frame import evenly
from proground_log.log.registration import Registration
from proground_log.palette import NOTHING_COLOR
from proground_log.report.figures import depth_picture, hex_color, jpeg_uri, png_uri
from proground_log.report.page import Content, Legend, Note, Picture, Views
from proground_log.run.opened import OpenedRun
from proground_log.run.settings import TelemetryConfig
from proground_log.telemetry.pictures import Pictures

FRAMES_SHOWN, VIEW_WIDTH = 4, 240


def view_contents(run: OpenedRun) -> list[Content]:
    """What the map of a run shows where the sensor saw it.

    The frames that were kept from the mapper are shown, where there are any.
    """
    config, reader = run.manifest.config, run.log
    held_out = config.held_out(len(reader))
    frames = held_out or list(config.selection.of(len(reader))[: config.max_frames])
    chosen = [frames[place] for place in evenly(len(frames), FRAMES_SHOWN)]
    description = run.map.description
    pictures = Pictures(
        TelemetryConfig(view_width=VIEW_WIDTH), reader.recording.bounds, description
    )
    register = Registration(reader.calibration)
    views = [pictures.view(run.map, register(sensor)) for sensor in reader.frames(chosen)]
    far_m = max(float(view.depth_m.max()) for view in views) or 1.0
    colors = np.array([NOTHING_COLOR], np.uint8)
    if description is not None:
        colors = np.concatenate([colors, description.task.prompt_colors()])
    kind = "kept from the mapper" if held_out else "mapped"
    parts: list[Content] = [
        Note(
            f"Frames {kind}: what the sensor saw, and what the map shows from there. "
            f"Depth from red (near) to blue ({far_m:.1f} m)."
        ),
        Views([(f"frame {view.frame_index}", _pair(view, far_m, colors)) for view in views]),
    ]
    if description is None:
        return [*parts, Note("No labels: the log has no regions, so no meaning was learnt.")]
    shown = np.unique([_labels_of(view) for view in views]).tolist()
    names = ("background", *description.task.all_prompts)
    return [*parts, Legend([(names[n + 1], hex_color(colors[n + 1])) for n in shown])]


def _labels_of(view: ViewRendered) -> np.ndarray:
    assert view.semantics is not None
    return np.stack([view.semantics.labels, view.semantics.observed_labels])


def _pair(view: ViewRendered, far_m: float, colors: np.ndarray) -> list[Picture]:
    """Input and rendered picture of each kind; colours [1 + K, 3], the background's first."""
    pictures = [
        Picture("colour, input", jpeg_uri(view.color)),
        Picture("colour, rendered", jpeg_uri(view.rendered_color)),
        Picture("depth, input", png_uri(depth_picture(view.depth_m, far_m))),
        Picture("depth, rendered", png_uri(depth_picture(view.rendered_depth_m, far_m))),
    ]
    if view.semantics is not None:
        observed, labels = view.semantics.observed_labels, view.semantics.labels
        pictures += [
            Picture("labels, input", png_uri(colors[observed + 1])),
            Picture("labels, rendered", png_uri(colors[labels + 1])),
        ]
    return pictures
