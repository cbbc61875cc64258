"""The command line: parses, calls, prints.

Everything heavy is imported in the command that needs it, so that `pglog --help` answers at once.
"""

from __future__ import annotations

import dataclasses
import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.table import Column, Table
from tyro.conf import Positional

from proground_log.errors import ProgroundError
from proground_log.frame import Selection
from replay.config import ReplayConfig

if TYPE_CHECKING:
    from proground_log.events import Sink
    from replay.manifest import Manifest

SAME, DIFFERENT, FAILED, STOPPED = 0, 1, 2, 130
"""Exit codes; STOPPED is what a shell expects after Ctrl-C."""

# Names of files are printed as they are: "[room]" is no markup, ":cat:" no picture.
out = Console(markup=False, emoji=False, highlight=False)
err = Console(stderr=True)

Log = Annotated[Path, Positional, tyro.conf.arg(metavar="LOG")]
Run = Annotated[Path, Positional, tyro.conf.arg(metavar="RUN")]
Output = Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="PATH")]
AsJson = Annotated[bool, tyro.conf.arg(name="json")]
MaybeInt = Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")]
MaybeFloat = Annotated[float | None, tyro.conf.arg(metavar="FLOAT", help_behavior_hint="")]
MaybePath = Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")]
app = tyro.extras.SubcommandApp()


@app.command(name="record")
def record_command(
    format: Annotated[str, Positional, tyro.conf.arg(metavar="FORMAT")],
    source: Annotated[
        Path | None, Positional, tyro.conf.arg(metavar="[SOURCE]", help_behavior_hint="")
    ] = None,
    *,
    output: Output,
    start: int = 0,
    stop: MaybeInt = None,
    stride: int = 1,
    calibration: MaybePath = None,
    max_time_difference_s: MaybeFloat = None,
    seed: MaybeInt = None,
    frames: MaybeInt = None,
    noise: bool = False,
    overwrite: bool = False,
) -> int:
    """Turn a data set into a log.

    Args:
        format: seven-scenes, tum, replica or synthetic (the built-in room).
        source: the data set; synthetic has none.
        output: the log to write (.mcap).
        start: first frame.
        stop: frame to stop before.
        stride: take every so many-th frame.
        calibration: JSON file that overrides the format's cameras.
        max_time_difference_s: tum: most between a colour and a depth image.
        seed: synthetic: varies the room.
        frames: synthetic: frames on the camera's way.
        noise: synthetic: noise of a real sensor.
        overwrite: replace the output.
    """
    from recorders.calibration_file import read_calibration
    from recorders.record import record
    from recorders.registry import open_source

    options: dict[str, object] = {
        "calibration": read_calibration(calibration) if calibration else None,
        "max_time_difference_s": max_time_difference_s,
        "seed": seed,
        "frames": frames,
        "noise": noise or None,
    }
    given = {name: value for name, value in options.items() if value is not None}
    opened = open_source(format, source, **given)
    name = source.resolve().name if source else format
    selection = Selection(start, stop, stride)
    with _progress("record") as progress:
        recording = record(opened, name, output, selection, overwrite=overwrite, progress=progress)
    size_mb = output.stat().st_size / 1e6
    print(f"{output}: {recording.frames} frames, {size_mb:.1f} MB")
    for keyword, note in recording.notes.items():
        print(f"  {keyword}: {note}")
    return SAME


@app.command(name="info")
def info_command(log: Log, *, as_json: AsJson = False) -> int:
    """Say what is in a log.

    Args:
        log: the log (.mcap).
        as_json: print JSON, for programs.
    """
    from proground_log.log.info import log_info

    info = log_info(log)
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
    _print_table(str(log), rows)
    _print_table("messages", {topic: str(count) for topic, count in info.messages.items()})
    return SAME


def _camera_text(camera: dict[str, object]) -> str:
    size = f"{camera['width']}x{camera['height']}"
    numbers = " ".join(f"{name} {camera[name]:.1f}" for name in ("fx", "fy", "cx", "cy"))
    return f"{size}, {numbers}" + (", distorted" if camera["distortion"] else "")


def _corner(corner_m: tuple[float, float, float]) -> str:
    return "(" + ", ".join(f"{value:.1f}" for value in corner_m) + ")"


@app.command(name="check")
def check_command(log: Log, *, as_json: AsJson = False) -> int:
    """Look for faults in a log: checksums, time, poses, images, depth. Exit code 1 if there are.

    Args:
        log: the log (.mcap).
        as_json: print JSON, for programs.
    """
    from proground_log.log.check import check_log

    with _progress("check") as progress:
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


@app.command(name="replay")
def replay_command(
    log: Log,
    *,
    output: Output,
    config: Annotated[ReplayConfig, tyro.conf.arg(name="")] = ReplayConfig(),
    threads: MaybeInt = None,
    resume: bool = False,
    overwrite: bool = False,
) -> int:
    """Replay a log through the online mapper.

    Args:
        log: the log (.mcap).
        output: folder of the run.
        config: settings.
        threads: compute on so many; the result is the same for any number.
        resume: go on with an interrupted run, with the run's own settings.
        overwrite: replace a run that is there.
    """
    from replay.device import set_threads
    from replay.session import ReplayStoppedError, replay

    set_threads(threads)
    try:
        manifest = replay(
            log, output, config, resume=resume, overwrite=overwrite, watchers=_progress_watcher
        )
    except ReplayStoppedError as stop:
        print(f"pglog: {stop}", file=sys.stderr)
        return STOPPED
    _print_summary(output, manifest)
    return SAME


def _progress_watcher(frames: int) -> list[Sink]:
    from replay.progress import ProgressSink

    return [ProgressSink(frames, err)]


def _print_summary(run: Path, manifest: Manifest) -> None:
    rows = {}
    for name, value in (manifest.result or {}).items():
        if isinstance(value, dict):
            value = ", ".join(f"{key} {number}" for key, number in value.items())
        rows[name] = str(value)
    _print_table(str(run), rows)


@app.command(name="diff")
def diff_command(first: Run, second: Run) -> int:
    """Name the first step at which two runs differ, and in what. Exit code 1 if they do.

    Args:
        first: folder of a run.
        second: folder of another.
    """
    from replay.diff import compare_runs

    comparison = compare_runs(first, second)
    for origin in comparison.origins:
        print(origin)
    divergence = comparison.divergence
    if divergence is not None:
        print(
            f"first difference: {divergence.cause}, at frame {divergence.frame}, "
            f"step {divergence.step} (ledger line {divergence.line})"
        )
        for detail in divergence.details:
            print(f"  {detail}")
    for name, difference in comparison.tensors.items():
        print(f"final {name}: {difference}")
    if comparison.is_same:
        print("the runs are equal, bit for bit")
    return SAME if comparison.is_same else DIFFERENT


@app.command(name="evaluate")
def evaluate_command(
    run: Run,
    *,
    log: MaybePath = None,
    voxel_m: float = 0.02,
    as_json: AsJson = False,
) -> int:
    """Judge a map by the frames held out of it, and by the true mesh where the log has one.

    Args:
        run: folder of a finished run.
        log: its log, where it has moved.
        voxel_m: voxels of the mesh that is compared with the true one.
        as_json: print JSON, for programs.
    """
    from replay.evaluate import evaluate_run

    with _progress("evaluate") as progress:
        scores = evaluate_run(run, log, voxel_m, progress)
    if as_json:
        print(json.dumps(scores, indent=2))
    else:
        _print_table(str(run), {name: f"{value:.2f}" for name, value in scores.items()})
    return SAME


@app.command(name="export")
def export_command(
    run: Run,
    what: Annotated[str, Positional, tyro.conf.arg(metavar="WHAT")],
    *,
    output: Output,
    voxel_m: float = 0.02,
    overwrite: bool = False,
) -> int:
    """Write the map for other tools.

    Args:
        run: folder of a finished run.
        what: mesh.
        output: the file to write (.ply).
        voxel_m: voxels of the mesh.
        overwrite: replace the output.
    """
    from proground_log.files import require_free
    from proground_log.mapping.map_file import load_map
    from proground_log.query.surface import extract_mesh, write_ply
    from replay.run_folder import RunFolder

    if what != "mesh":
        raise ProgroundError(f"there is no export {what!r}", where="export", todo="use mesh")
    require_free(output, overwrite=overwrite)
    with err.status("extracting the mesh"):
        mesh = extract_mesh(load_map(RunFolder(run).require_finished().map), voxel_m)
        write_ply(output, mesh)
    print(f"{output}: {len(mesh.vertices_m)} vertices, {len(mesh.faces)} faces")
    return SAME


@app.command(name="view")
def view_command(
    paths: Annotated[
        tuple[Path, ...], Positional, tyro.conf.arg(metavar="LOG|RUN ...", help_behavior_hint="")
    ] = (),
    *,
    web: bool = False,
) -> int:
    """Open logs and runs in the rerun viewer.

    Args:
        paths: logs (.mcap) or folders of runs.
        web: serve the viewer to a browser on this machine instead of opening a window.
    """
    from proground_log.telemetry.viewer import view

    if not paths:
        raise ProgroundError(
            "there is nothing to open", where="view", todo="give logs (.mcap) or folders of runs"
        )
    view(paths, web=web)
    return SAME


@app.command(name="demo")
def demo_command(*, output: Output, seed: int = 0, overwrite: bool = False) -> int:
    """Record the built-in room, map it and judge the map: all of it, in about two minutes.

    Args:
        output: folder for room.mcap and run/.
        seed: varies the room and every draw.
        overwrite: replace an earlier demo.
    """
    log, run = output / "room.mcap", output / "run"
    record_command("synthetic", output=log, seed=seed, overwrite=overwrite)
    config = ReplayConfig(seed=seed, hold_out_every=10)
    replay_command(log, output=run, config=config, overwrite=overwrite)
    evaluate_command(run)
    print(f"\nlook at it:      pglog view {run}\nlook at the log: pglog view {log}")
    return SAME


@contextmanager
def _progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar; it appears when it is first told how many are done, and of how many."""
    from replay.progress import progress_bar

    bar = progress_bar(err)
    task = bar.add_task(what, total=None, note="")

    def move(done: int, total: int) -> None:
        bar.start()
        bar.update(task, completed=done, total=total)

    try:
        yield move
    finally:
        if bar.live.is_started:
            bar.stop()


def _print_table(title: str, rows: dict[str, str]) -> None:
    table = Table(Column(overflow="fold"), Column(overflow="fold"), show_header=False)
    for name, value in rows.items():
        table.add_row(name, value)
    print(title)
    out.print(table)


def main() -> None:
    """Run a command; its result is the exit code."""
    try:
        code = app.cli(
            prog="pglog",
            description="Map RGB-D logs online, offline: record, replay, compare, look.",
            config=(tyro.conf.FlagCreatePairsOff,),
        )
    except ProgroundError as error:
        print(f"pglog: {error}", file=sys.stderr)
        code = FAILED
    except BrokenPipeError:
        # Whoever reads the output (head, less) has seen enough; nothing more can be printed.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = FAILED
    except OSError as error:
        reason = f"{error.filename or 'pglog'}: {(error.strerror or str(error)).lower()}"
        print(f"pglog: {reason}; check the path and its permissions", file=sys.stderr)
        code = FAILED
    except KeyboardInterrupt:
        print("pglog: stopped", file=sys.stderr)
        code = STOPPED
    sys.exit(code)


if __name__ == "__main__":
    main()
