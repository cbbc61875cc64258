"""Commands about logs: info, check."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

from rich.table import Column, Table

from pglog.common import (
    DIFFERENT,
    SAME,
    AsJson,
    Log,
    out,
    print_table,
    shown_progress,
)


def info_command(
    log: Log, *, sheet: Path | None = None, as_json: AsJson = False, overwrite: bool = False
) -> int:
    """Say what is in a log.

    Args:
        log: the log (.mcap).
        sheet: also draw frames, depth, labels and the camera's way into a picture (.png).
        as_json: print JSON, for programs.
        overwrite: replace the picture.
    """
    from proground_log.log.info import log_info

    info = log_info(log)
    if sheet is not None:
        from proground_log.log.sheet import draw_sheet

        draw_sheet(log, sheet, overwrite=overwrite)
    if as_json:
        print(json.dumps(dataclasses.asdict(info), indent=2))
        return SAME
    rate_hz = (info.frames - 1) / info.duration_s if info.duration_s else 0.0
    depth_camera = f"{_camera_text(info.depth_camera)}, {100 * info.baseline_m:.1f} cm away"
    ground_truth = [f"{len(info.labels)} labels"] * bool(info.labels) + ["mesh"] * info.has_mesh
    rows = {
        "source": f"{info.source} ({info.format})",
        "size": f"{info.size_bytes / 1e6:.1f} MB",
        "frames": f"{info.frames} in {info.duration_s:.2f} s ({rate_hz:.1f} Hz)",
        "colour camera": _camera_text(info.color_camera),
        "depth camera": "the same" if info.registered else depth_camera,
        "bounds": f"{_corner(info.bounds_lower_m)} to {_corner(info.bounds_upper_m)} m",
        "ground truth": ", ".join(ground_truth) or "none",
        **info.notes,
    }
    if info.task is not None:
        rows["task"] = f"{info.task.name}: {', '.join(info.task.prompts)}"
        rows["regions"] = str(info.task.regions)
    if info.warnings:
        rows["warnings"] = "\n".join(info.warnings)
    print_table(str(log), rows)
    print_table("messages", {topic: str(count) for topic, count in info.messages.items()})
    return SAME


def _camera_text(camera: dict[str, object]) -> str:
    size = f"{camera['width']}x{camera['height']}"
    numbers = " ".join(f"{name} {camera[name]:.1f}" for name in ("fx", "fy", "cx", "cy"))
    return f"{size}, {numbers}" + (", distorted" if camera["distortion"] else "")


def _corner(corner_m: tuple[float, float, float]) -> str:
    return "(" + ", ".join(f"{value:.1f}" for value in corner_m) + ")"


def check_command(log: Log, *, as_json: AsJson = False) -> int:
    """Look for faults in a log: checksums, time, poses, images, depth. Exit code 1 if there are.

    Args:
        log: the log (.mcap).
        as_json: print JSON, for programs.
    """
    from proground_log.log.checking.check import check_log

    with shown_progress("check") as progress:
        faults = check_log(log, progress)
    if as_json:
        print(json.dumps([dataclasses.asdict(fault) for fault in faults], indent=2))
    elif faults:
        print(f"{log}: {len(faults)} {'fault' if len(faults) == 1 else 'faults'}")
        table = Table(*(Column(name, overflow="fold") for name in ("frame", "topic", "fault")))
        for fault in faults:
            table.add_row(fault.frame, fault.topic, fault.what)
        out.print(table)
    else:
        print(f"{log}: no fault found")
    return DIFFERENT if faults else SAME
