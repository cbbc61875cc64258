"""The replay: a log, frame by frame, through the online mapper, told to sinks as events.

In lock-step the next frame arrives when the mapper is free, and every mapped frame gets the same
number of steps; simulated time is the log's own.
"""

from __future__ import annotations

import resource
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from proground_log.errors import ProgroundError
from proground_log.events import (
    Event,
    FrameArrived,
    FrameDone,
    RunFinished,
    Sink,
    StateDigested,
    StepDone,
    TaskKnown,
)
from proground_log.files import disk_errors, require_free
from proground_log.frame import Frame
from proground_log.log.reader import LogReader
from proground_log.log.registration import Registration
from proground_log.mapping.map_file import NeuralMap, save_map
from proground_log.mapping.online_mapper import OnlineMapper
from proground_log.mapping.semantic_map import SemanticMap
from proground_log.perception.description import PerceptionDescription
from proground_log.perception.of_log import perception_of
from proground_log.perception.perceiver import Perceiver
from proground_log.perception.preview import prompt_colors
from proground_log.telemetry.rerun_sink import TelemetrySink
from proground_log.telemetry.segments import merge_segments
from replay.config import ReplayConfig
from replay.device import choose_device
from replay.digests import frame_digest, state_digests
from replay.ledger import LedgerSink
from replay.manifest import Manifest, file_sha256, fingerprint
from replay.pictures import Pictures
from replay.run_folder import Checkpoint, RunFolder

STAGES = ("read", "perceive", "map", "views", "telemetry", "ledger")
"""What the machine's time is spent on."""


class ReplayStoppedError(Exception):
    """The user stopped the replay; the run can be resumed."""


def replay(
    log_path: Path,
    run_path: Path,
    config: ReplayConfig,
    *,
    resume: bool = False,
    overwrite: bool = False,
    perceiver: Perceiver | None = None,
    watchers: Callable[[int], Sequence[Sink]] = lambda _: (),
) -> Manifest:
    """Replay a log into a run.

    Args:
        log_path: the log.
        run_path: folder of the run.
        config: the settings; with `resume` those of the run itself hold.
        resume: go on with an interrupted run.
        overwrite: replace a run that is there.
        perceiver: finds the regions of each frame, for a log that has none yet.
        watchers: given the number of frames to come, further sinks, such as a progress bar.

    Returns:
        The manifest of the finished run, with its summary.

    Raises:
        ReplayStoppedError: the user stopped it; the run can be resumed.
    """
    reader = LogReader(log_path)
    device = choose_device(config.device)
    perception = perceiver.description if perceiver is not None else perception_of(reader)
    run = RunFolder(run_path)
    if resume:
        manifest = _manifest_to_resume(run, log_path, config, perception)
        if run.is_finished:
            return manifest
    else:
        require_free(run.manifest, overwrite=overwrite)
        if run_path.exists() and not run_path.is_dir():
            raise ProgroundError("is a file", where=run_path, todo="name a folder for the run")
        manifest = Manifest.of(log_path, config, device, perception)
        config.selection.of(len(reader))
        with disk_errors(run_path):
            run_path.mkdir(parents=True, exist_ok=True)
        run.clear()
        manifest.write(run.manifest)
    session = Session(reader, run, manifest, device, perception, perceiver)
    with _stop_on_signals(session):
        summary = session.run(watchers)
    finished = replace(manifest, result=summary)
    finished.write(run.manifest)
    return finished


def _manifest_to_resume(
    run: RunFolder,
    log_path: Path,
    config: ReplayConfig,
    perception: PerceptionDescription | None,
) -> Manifest:
    if not run.manifest.is_file():
        raise ProgroundError(
            "there is no run to resume", where=run.path, todo="leave out --resume to start one"
        )
    manifest = Manifest.read(run.manifest)
    if config not in (ReplayConfig(), manifest.config):
        raise ProgroundError(
            "the options differ from those that the run was started with",
            where=run.path,
            todo="leave them out: --resume goes on with the run's own",
        )
    if file_sha256(log_path) != manifest.log_sha256:
        raise ProgroundError(
            "the log is not the one that the run was started with",
            where=log_path,
            todo=f"give the same log (it was {manifest.log_path})",
        )
    if manifest.perception_sha256 != fingerprint(perception):
        raise ProgroundError(
            "the perception is not the one that the run was started with",
            where=run.path,
            todo="give the same task and models",
        )
    return manifest


class Session:
    """One replay in progress.

    Args:
        reader: the log.
        run: where the results go; its checkpoint, where there is one, is gone on from.
        manifest: what makes the run.
        device: cpu or cuda.
        perception: what the regions of the frames mean; None where there are none.
        perceiver: finds them, where the log has none.
    """

    def __init__(
        self,
        reader: LogReader,
        run: RunFolder,
        manifest: Manifest,
        device: str,
        perception: PerceptionDescription | None,
        perceiver: Perceiver | None,
    ) -> None:
        self._reader, self._run, self._config = reader, run, manifest.config
        self._perceiver = perceiver
        self._recording_id = f"{manifest.log_sha256[:16]}-{manifest.config.seed}"
        self._mapper = OnlineMapper(
            self._config.mapper, reader.recording.bounds, self._config.seed, device, perception
        )
        learnt = perception if self._mapper.semantics is not None else None
        self._pictures = Pictures(self._config.telemetry, reader.recording.bounds, learnt)
        self._arrived = self._mapped = self._steps = self._lines = self._start_ns = 0
        self._camera_m: list[float] = []
        self._seconds = dict.fromkeys(STAGES, 0.0)
        self._stop = threading.Event()
        if run.checkpoint.is_file():
            checkpoint = Checkpoint.read(run.checkpoint)
            self._mapper.restore(checkpoint.state)
            self._arrived, self._mapped = checkpoint.arrived, checkpoint.mapped
            self._steps, self._lines = checkpoint.steps, checkpoint.ledger_lines
            self._start_ns, self._camera_m = checkpoint.start_ns, checkpoint.camera_m
            self._seconds = dict(checkpoint.seconds)

    def stop(self) -> None:
        """Stop after the frame at hand."""
        self._stop.set()

    def run(self, watchers: Callable[[int], Sequence[Sink]]) -> dict[str, object]:
        """Replay to the end; raises `ReplayStoppedError` when stopped."""
        config, run = self._config, self._run
        chosen = config.selection.of(len(self._reader))[: config.max_frames]
        self._ledger = LedgerSink(run.partial_ledger, self._lines)
        self._telemetry: TelemetrySink | None = None
        if config.telemetry.enabled:
            self._telemetry = TelemetrySink(
                run.next_telemetry_segment(),
                recording_id=self._recording_id,
                steps_done=self._steps,
                last_position_m=np.array(self._camera_m) if self._camera_m else None,
            )
        self._watchers = watchers(len(chosen) - self._arrived)
        with ExitStack() as sinks:
            for sink in (self._ledger, self._telemetry, *self._watchers):
                if sink is not None:
                    sinks.callback(sink.close)
            self._introduce()
            for frame in self._frames(chosen[self._arrived :]):
                self._take(frame, chosen)
                if self._stop.is_set() and self._arrived < len(chosen):
                    self._write_checkpoint()
                    raise ReplayStoppedError(
                        f"stopped after {self._arrived} of {len(chosen)} frames; go on with "
                        f"`pglog replay {self._reader.path} -o {run.path} --resume`"
                    )
                if self._arrived % config.checkpoint_every == 0:
                    self._write_checkpoint()
            self._digest()
            summary = self._summary()
            self._emit(RunFinished(summary))
        self._finish()
        return summary

    def _introduce(self) -> None:
        """Say what the labels of all that follows mean."""
        learner = self._mapper.semantics
        if learner is not None:
            task = learner.description.task
            self._emit(TaskKnown(task.name, task.all_prompts, prompt_colors(task)))

    def _frames(self, chosen: Sequence[int]) -> Iterator[Frame]:
        """The chosen frames, registered."""
        register = Registration(self._reader.calibration)
        sensor_frames = self._reader.frames(chosen) if chosen else iter(())
        while True:
            with self._timed("read"):
                sensor = next(sensor_frames, None)
            if sensor is None:
                return
            if self._perceiver is not None:
                with self._timed("perceive"):
                    sensor = replace(sensor, regions=self._perceiver(sensor))
            with self._timed("read"):
                frame = register(sensor)
            yield frame

    def _take(self, frame: Frame, chosen: Sequence[int]) -> None:
        """One frame's whole way: arrival, insertion, steps, telemetry."""
        if self._arrived == 0:
            self._start_ns = frame.stamp_ns
        sim_time_ns = frame.stamp_ns - self._start_ns
        self._camera_m = frame.world_from_camera[:3, 3].tolist()
        self._arrived += 1
        every = self._config.hold_out_every
        held_out = every > 0 and self._arrived % every == 0
        with self._timed("ledger"):
            digest = frame_digest(frame)
        self._emit(FrameArrived(frame, sim_time_ns, digest, held_out))
        steps = 0
        if not held_out:
            with self._timed("map"):
                inserted = self._mapper.insert(frame)
            if inserted is not None:
                self._emit(inserted)
            steps = self._map(frame, sim_time_ns)
            self._mapped += 1
        semantics = self._mapper.semantics
        self._emit(
            FrameDone(
                frame.index,
                steps,
                sim_time_ns,
                self._mapper.buffer.statistics(),
                semantics.statistics() if semantics is not None else None,
            )
        )
        last = self._arrived == len(chosen)
        if self._telemetry is not None and (last or not held_out):
            self._show(frame, last=last)

    def _map(self, frame: Frame, sim_time_ns: int) -> int:
        """The steps that a mapped frame gets; returns how many were done."""
        for iteration in range(self._config.steps):
            with self._timed("map"):
                result = self._mapper.step()
            if result is None:
                return iteration
            self._emit(
                StepDone(
                    frame_index=frame.index,
                    step=self._steps,
                    iteration=iteration,
                    sim_time_ns=sim_time_ns,
                    losses=result.losses,
                    draws_digest=result.draws_digest,
                    rays_current=result.rays_current,
                    rays_replayed=result.rays_replayed,
                )
            )
            self._steps += 1
            if self._steps % self._config.digest_every == 0:
                self._digest()
        return self._config.steps

    def _digest(self) -> None:
        with self._timed("ledger"):
            digests = state_digests(self._mapper.state())
        self._emit(StateDigested(self._steps, digests))

    def _show(self, frame: Frame, *, last: bool) -> None:
        """Render what telemetry wants to see of this frame."""
        telemetry = self._config.telemetry
        number = self._mapped - 1
        if last or number % telemetry.view_every == 0:
            with self._timed("views"):
                view = self._pictures.view(self._map_so_far(), frame)
            self._emit(view)
            if self._mapper.semantics is not None:
                with self._timed("views"):
                    scores = self._mapper.semantics.scores(frame.index)
                if scores is not None:
                    self._emit(scores)
        if last or number % telemetry.mesh_every == telemetry.mesh_every - 1:
            with self._timed("views"):
                mesh = self._pictures.mesh(self._map_so_far(), frame.index)
            self._emit(mesh)

    def _map_so_far(self) -> NeuralMap:
        learner, semantics = self._mapper.semantics, None
        if learner is not None:
            semantics = SemanticMap(learner.heads, learner.description)
        return NeuralMap(self._mapper.averaged, self._mapper.observed, semantics)

    def _emit(self, event: Event) -> None:
        with self._timed("ledger"):
            self._ledger.on_event(event)
        if self._telemetry is not None:
            with self._timed("telemetry"):
                self._telemetry.on_event(event)
        for watcher in self._watchers:
            watcher.on_event(event)

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        """Add the machine's time to a stage; it goes into the summary and nowhere else."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self._seconds[stage] += time.perf_counter() - start

    def _write_checkpoint(self) -> None:
        """Keep all that a resumed run needs, ledger and telemetry first."""
        self._ledger.flush()
        if self._telemetry is not None:
            self._telemetry.flush()
        Checkpoint(
            arrived=self._arrived,
            mapped=self._mapped,
            steps=self._steps,
            ledger_lines=self._ledger.lines,
            start_ns=self._start_ns,
            camera_m=self._camera_m,
            seconds=self._seconds,
            state=self._mapper.state(),
        ).write(self._run.checkpoint)

    def _summary(self) -> dict[str, object]:
        buffer = self._mapper.buffer.statistics()
        return {
            "frames arrived": self._arrived,
            "frames mapped": self._mapped,
            "frames held out": self._arrived - self._mapped,
            "steps": self._steps,
            "buffer samples": buffer.samples,
            "buffer keyframes": buffer.keyframes,
            "buffer MB": round(buffer.size_bytes / 1e6, 2),
            "map MB": round(sum(self._map_so_far().sizes_bytes().values()) / 1e6, 2),
            "peak memory MB": round(peak_memory_bytes() / 1e6),
            **self._semantic_summary(),
            "machine s": {stage: round(s, 3) for stage, s in self._seconds.items()},
        }

    def _semantic_summary(self) -> dict[str, object]:
        learner = self._mapper.semantics
        if learner is None:
            return {}
        statistics = learner.statistics()
        return {
            "task": learner.description.task.name,
            "semantic samples": statistics.samples,
            "semantic regions": statistics.regions,
            "semantic MB": round(statistics.size_bytes / 1e6, 2),
        }

    def _finish(self) -> None:
        """Give the results their final names, the map last: it says that the run is finished."""
        run = self._run
        if self._config.telemetry.enabled:
            merge_segments(run.telemetry_segments(), run.telemetry)
        run.partial_ledger.replace(run.ledger)
        save_map(run.map, self._map_so_far())
        for segment in run.telemetry_segments():
            segment.unlink()
        run.checkpoint.unlink(missing_ok=True)


def peak_memory_bytes() -> int:
    """Most memory this process ever had resident."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


@contextmanager
def _stop_on_signals(session: Session) -> Iterator[None]:
    """Let Ctrl-C stop the session after a frame; a second one stops it at once."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handle(number: int, _: object) -> None:
        session.stop()
        signal.signal(number, previous[signal.Signals(number)])

    previous = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        for number in previous:
            signal.signal(number, handle)
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
