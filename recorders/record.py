"""Recording: a source becomes a log."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from proground_log.errors import ProgroundError
from proground_log.files import partial_of, require_free
from proground_log.frame import Selection
from proground_log.log.checking.consistency import Consistency
from proground_log.log.recording import Origin, Recording
from proground_log.log.writer import LogWriter, open_writer
from recorders.bounds import BoundsEstimator
from recorders.prefetch import default_jobs, prefetched
from recorders.source import Source


def record(
    source: Source,
    source_name: str,
    output: Path,
    selection: Selection,
    *,
    overwrite: bool,
    progress: Callable[[int, int], None],
    jobs: int | None = None,
) -> Recording:
    """Write the selected frames of a source into a log, one at a time.

    The frames are compared with one another on the way: what looks wrong becomes a warning. Where
    the user, the disk or the source stops it, what is written stays beside the output.

    Args:
        source: the data set.
        source_name: what the log calls it.
        output: the log; takes its name once it is whole.
        selection: which frames.
        overwrite: replace a log that is there.
        progress: told the frames written and the frames in all.
        jobs: threads to read with; None for what the machine has. The log is the same.

    Returns:
        What the log says about itself.
    """
    require_output(output, overwrite=overwrite)
    jobs = default_jobs() if jobs is None else jobs
    if jobs < 1:
        raise ProgroundError(f"{jobs} jobs are asked for", where="record", todo="ask for 1 or more")
    chosen = selection.of(len(source))
    estimator, consistency = BoundsEstimator(), Consistency()
    origin = Origin(source_name, source.name, source.notes)
    mesh = source.ground_truth_mesh()
    with (
        _partial_named(output) as writers,
        open_writer(output, source.calibration, origin, source.label_names, mesh) as writer,
    ):
        writers.append(writer)
        progress(0, len(chosen))
        for done, frame in enumerate(prefetched(source.frame, chosen, jobs), start=1):
            estimator.add(frame, (frame.calibration or source.calibration).depth)
            consistency.add(frame, source.calibration)
            writer.write(frame)
            progress(done, len(chosen))
        report = consistency.report()
        recording = Recording(
            source=source_name,
            format=source.name,
            frames=writer.frames,
            bounds=estimator.bounds(),
            notes={**source.notes, "agreement": report.note},
            warnings=(*source.warnings, *report.warnings),
        )
        writer.finish(recording)
    return recording


def require_output(output: Path, *, overwrite: bool) -> None:
    """Raise a ProgroundError where a log, or what a recording left of one, is in the way."""
    require_free(output, overwrite=overwrite)
    partial = partial_of(output)
    if partial.exists() and not overwrite:
        raise ProgroundError(
            "is what a recording that was stopped left",
            where=partial,
            todo=f"save it by `pglog recover {partial} -o {output}`, or pass --overwrite",
        )


@contextmanager
def _partial_named(output: Path) -> Iterator[list[LogWriter]]:
    """Where a recording is stopped and something of it stays, say how to save that.

    Gives a list, for the writer once it is open.
    """
    writers: list[LogWriter] = []
    try:
        yield writers
    except (KeyboardInterrupt, ProgroundError) as error:
        partial = partial_of(output)
        frames = sum(writer.frames_saved for writer in writers)
        if not partial.is_file():
            raise
        if not frames:
            partial.unlink()
            raise
        todo = f"`pglog recover {partial} -o {output}` saves the frames so far: {frames}"
        if isinstance(error, ProgroundError):
            todo = f"{error.todo}; {todo}"
            raise ProgroundError(error.what, where=error.where, todo=todo) from error
        raise KeyboardInterrupt(todo) from error
