"""One replay in progress: turn by turn through the mapper, told to sinks as events."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, replace
from typing import Protocol

import numpy as np

from proground_log.events import (
    Event,
    FrameArrived,
    FrameDone,
    FrameDropped,
    FrameScheduled,
    RegionsArrived,
    RunFinished,
    Sink,
    StateDigested,
    StepDone,
    TaskKnown,
)
from proground_log.frame import Frame, SensorFrame
from proground_log.log.reader import LogReader
from proground_log.log.registration import Registration
from proground_log.mapping.map_file import NeuralMap, save_map
from proground_log.mapping.online_mapper import OnlineMapper
from proground_log.mapping.semantic_map import SemanticMap
from proground_log.perception.description import PerceptionDescription
from proground_log.perception.perceiver import Perceiver
from proground_log.run.folder import Checkpoint, RunFolder
from proground_log.run.ledger import LedgerSink
from proground_log.run.manifest import Manifest
from proground_log.telemetry.pictures import Pictures
from proground_log.telemetry.rerun_sink import TelemetrySink
from proground_log.telemetry.segments import merge_segments
from replay.digests import frame_digest, state_digests
from replay.plan import Plan, Turn
from replay.scheduler import Drop, RegionsReady, Slot
from replay.tally import Tally, summary_of

STAGES = ("decode", "perceive", "insert", "step", "views", "telemetry", "ledger")
"""What the machine's time is spent on; the first four are simulated too."""


class ReplayStoppedError(Exception):
    """The replay stopped before its end; the run can be resumed.

    Args:
        message: where it stands, and how to go on.
        is_interruption: whether by Ctrl-C, rather than where the user wanted it from the start.
    """

    def __init__(self, message: str, *, is_interruption: bool = True) -> None:
        super().__init__(message)
        self.is_interruption = is_interruption


class Pause(Protocol):
    """Lets a user look at a replay between two frames."""

    def wants(self, frame: int) -> bool:
        """Whether to pause after this frame of the log."""
        ...

    def go_on(self, frame: int) -> bool:
        """Wait; whether the user wants to go on, rather than stop."""
        ...


class Runner:
    """One replay in progress.

    Args:
        reader: the log.
        run: where the results go; its checkpoint, where there is one, is gone on from.
        manifest: what makes the run.
        plan: the turns of the frames.
        device: cpu or cuda.
        perception: what the regions of the frames mean; None where there are none.
        perceiver: finds them, where the log has none.
        until_frame: stop after this frame of the log; None: go on to the end.
        pause: asked after every frame.
    """

    def __init__(
        self,
        reader: LogReader,
        run: RunFolder,
        manifest: Manifest,
        plan: Plan,
        device: str,
        perception: PerceptionDescription | None,
        perceiver: Perceiver | None,
        until_frame: int | None = None,
        pause: Pause | None = None,
    ) -> None:
        self._reader, self._run, self._config = reader, run, manifest.config
        self._manifest, self._plan, self._perceiver = manifest, plan, perceiver
        self._until_frame, self._pause = until_frame, pause
        self._recording_id = f"{manifest.log_sha256[:16]}-{manifest.config.seed}"
        self._mapper = OnlineMapper(
            self._config.mapper, reader.recording.bounds, self._config.seed, device, perception
        )
        learnt = perception if self._mapper.semantics is not None else None
        self._pictures = Pictures(self._config.telemetry, reader.recording.bounds, learnt)
        self._register = Registration(reader.calibration)
        self._turns = self._steps = self._lines = 0
        self._camera_m: list[float] = []
        self._tally = Tally()
        self._seconds = dict.fromkeys(STAGES, 0.0)
        self._segments_bytes: list[int] = []
        self._unperceived: dict[int, Frame] = {}
        self._stop = threading.Event()
        if run.checkpoint.is_file():
            self._go_on_from(Checkpoint.read(run.checkpoint))

    def _go_on_from(self, checkpoint: Checkpoint) -> None:
        self._mapper.restore(checkpoint.state)
        self._turns, self._steps = checkpoint.turns, checkpoint.steps
        self._lines, self._camera_m = checkpoint.ledger_lines, checkpoint.camera_m
        self._tally, self._seconds = Tally(**checkpoint.simulation), dict(checkpoint.seconds)
        self._segments_bytes = list(checkpoint.telemetry_bytes)

    def stop(self) -> None:
        """Stop after the frame at hand."""
        self._stop.set()

    def run(self, watchers: Callable[[int], Sequence[Sink]]) -> dict[str, object]:
        """Replay to the end; raises `ReplayStoppedError` when stopped."""
        turns = list(self._plan.turns())
        self._ledger = LedgerSink(self._run.partial_ledger, self._lines)
        self._telemetry = self._open_telemetry()
        self._watchers = watchers(len(turns) - self._turns)
        with ExitStack() as sinks:
            for sink in (self._ledger, self._telemetry, *self._watchers):
                if sink is not None:
                    sinks.callback(sink.close)
            self._introduce()
            self._recall(turns[: self._turns])
            ahead = turns[self._turns :]
            for turn, sensor in zip(ahead, self._sensor_frames(ahead), strict=True):
                self._take(turn, sensor, is_last=self._turns + 1 == len(turns))
                if self._turns < len(turns):
                    self._between(turn, len(turns))
            self._digest()
            summary = self._summary()
            self._emit(RunFinished(summary))
        self._finish(summary)
        return summary

    def _open_telemetry(self) -> TelemetrySink | None:
        """A new segment; what earlier ones say beyond the checkpoint will be said again."""
        if not self._config.telemetry.enabled:
            return None
        segments = self._run.telemetry_segments()
        lengths = [*self._segments_bytes, *[0] * len(segments)]
        for segment, length in zip(segments, lengths, strict=False):
            with segment.open("r+b") as file:
                file.truncate(length)
        return TelemetrySink(
            self._run.next_telemetry_segment(),
            recording_id=self._recording_id,
            steps_done=self._steps,
            last_position_m=np.array(self._camera_m) if self._camera_m else None,
            dropped_before=sum(self._tally.dropped.values()),
        )

    def _introduce(self) -> None:
        """Say what the labels of all that follows mean."""
        learner = self._mapper.semantics
        if learner is not None:
            task = learner.description.task
            self._emit(TaskKnown(task.name, task.all_prompts, task.prompt_colors()))

    def _recall(self, taken: Sequence[Turn]) -> None:
        """Read again the frames whose regions are still being found beside the mapper."""
        due: list[int] = []
        for turn in taken:
            if turn.slot is not None and self._plan.policy.beside:
                due += [turn.slot.frame] * turn.slot.is_perceived
                for event in turn.slot.meanwhile:
                    if isinstance(event, RegionsReady):
                        due = [frame for frame in due if frame > event.frame]
        for sensor in self._reader.frames(due) if due else ():
            self._unperceived[sensor.index] = self._perceived(sensor)

    def _sensor_frames(self, turns: Sequence[Turn]) -> Iterator[SensorFrame]:
        frames = self._reader.frames([turn.frame for turn in turns]) if turns else iter(())
        while True:
            with self._timed("decode"):
                sensor = next(frames, None)
            if sensor is None:
                return
            yield sensor

    def _take(self, turn: Turn, sensor: SensorFrame, *, is_last: bool) -> None:
        """One frame's whole way: arrival, insertion, steps, telemetry."""
        slot = turn.slot
        if slot is None:
            frame = self._registered(replace(sensor, regions=None))
            self._arrive(frame, turn.sim_time_ns, held_out=True)
            self._done(frame.index, 0, turn.sim_time_ns)
        else:
            frame = self._map(slot, sensor)
        self._turns += 1
        if self._telemetry is not None and (is_last or slot is not None):
            self._show(frame, is_last=is_last)

    def _map(self, slot: Slot, sensor: SensorFrame) -> Frame:
        """All that happens in a slot; returns the frame as the mapper saw it."""
        beside = self._plan.policy.beside
        happened = deque(slot.meanwhile)
        self._tell(happened, slot.begin_ns)
        if slot.is_perceived:
            frame = self._perceived(sensor)
            if beside:
                self._unperceived[slot.frame] = frame
                frame = replace(frame, regions=None, region_of=None)
        else:
            frame = self._registered(replace(sensor, regions=None))
        self._arrive(frame, slot.begin_ns, held_out=False)
        with self._timed("insert"):
            inserted = self._mapper.insert(frame, is_keyframe=slot.is_keyframe)
        if inserted is not None:
            self._emit(inserted)
        done = 0
        step_ns = self._plan.timing.step_ns
        first_ns = slot.end_ns - slot.steps * step_ns
        self._tell(happened, first_ns)
        for iteration in range(slot.steps):
            done += self._step(frame, iteration, first_ns + (iteration + 1) * step_ns, happened)
        self._tell(happened, slot.end_ns)
        self._emit(
            FrameScheduled(
                frame_index=slot.frame,
                sim_time_ns=slot.end_ns,
                arrived_ns=slot.arrived_ns,
                idle_ns=slot.begin_ns - self._tally.end_ns,
                waiting=slot.waiting,
                steps=slot.steps,
                overrun_ns=slot.overrun_ns,
                spans=self._plan.spans(slot),
            )
        )
        self._done(slot.frame, done, slot.end_ns)
        return frame

    def _registered(self, sensor: SensorFrame) -> Frame:
        with self._timed("decode"):
            return self._register(sensor)

    def _perceived(self, sensor: SensorFrame) -> Frame:
        """The frame with its regions, from the log or from the perceiver."""
        if self._perceiver is not None:
            with self._timed("perceive"):
                sensor = replace(sensor, regions=self._perceiver(sensor))
        return self._registered(sensor)

    def _tell(self, happened: deque[Drop | RegionsReady], until_ns: int) -> None:
        """What happened beside the mapper up to a moment."""
        while happened and happened[0].at_ns <= until_ns:
            event = happened.popleft()
            if isinstance(event, Drop):
                self._emit(FrameDropped(event.frame, event.at_ns, event.reason))
                continue
            frame = self._unperceived.pop(event.frame)
            # Perception takes the newest frame: older ones that waited never get their turn.
            self._unperceived = {n: f for n, f in self._unperceived.items() if n > event.frame}
            with self._timed("insert"):
                self._mapper.insert_regions(frame)
            self._emit(RegionsArrived(event.frame, event.begin_ns, event.at_ns))

    def _arrive(self, frame: Frame, sim_time_ns: int, *, held_out: bool) -> None:
        self._camera_m = frame.world_from_camera[:3, 3].tolist()
        with self._timed("ledger"):
            digest = frame_digest(frame)
        self._emit(FrameArrived(frame, sim_time_ns, digest, held_out))

    def _step(
        self,
        frame: Frame,
        iteration: int,
        sim_time_ns: int,
        happened: deque[Drop | RegionsReady],
    ) -> bool:
        """One optimisation step; whether there was anything to learn from."""
        with self._timed("step"):
            result = self._mapper.step()
        # What came during the step counts from the next one on.
        self._tell(happened, sim_time_ns)
        if result is None:
            return False
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
        return True

    def _digest(self) -> None:
        with self._timed("ledger"):
            digests = state_digests(self._mapper.state())
        self._emit(StateDigested(self._steps, digests))

    def _done(self, frame_index: int, steps: int, sim_time_ns: int) -> None:
        semantics = self._mapper.semantics
        self._emit(
            FrameDone(
                frame_index,
                steps,
                sim_time_ns,
                self._mapper.buffer.statistics(),
                semantics.statistics() if semantics is not None else None,
            )
        )

    def _between(self, turn: Turn, total: int) -> None:
        """After a frame that is not the last: checkpoints, pauses, stops."""
        is_wanted = self._until_frame is not None and turn.frame >= self._until_frame
        if self._pause is not None and self._pause.wants(turn.frame):
            self._flush()
            is_wanted |= not self._pause.go_on(turn.frame)
        if is_wanted or self._stop.is_set():
            self._write_checkpoint()
            raise ReplayStoppedError(
                f"stopped after frame {turn.frame}, {self._turns} of {total}; go on with "
                f"`pglog replay {self._reader.path} -o {self._run.path} --resume`"
                f"{' and the same options of perception' if self._perceiver is not None else ''}",
                is_interruption=self._stop.is_set(),
            )
        if self._turns % self._config.checkpoint_every == 0:
            self._write_checkpoint()

    def _show(self, frame: Frame, *, is_last: bool) -> None:
        """Render what telemetry wants to see of this frame."""
        telemetry = self._config.telemetry
        number = self._tally.mapped - 1
        if is_last or number % telemetry.view_every == 0:
            with self._timed("views"):
                view = self._pictures.view(self._map_so_far(), frame)
            self._emit(view)
            if self._mapper.semantics is not None:
                with self._timed("views"):
                    scores = self._mapper.semantics.scores(frame.index)
                if scores is not None:
                    self._emit(scores)
        if is_last or number % telemetry.mesh_every == telemetry.mesh_every - 1:
            with self._timed("views"):
                mesh = self._pictures.mesh(self._map_so_far(), frame.index)
            self._emit(mesh)

    def _map_so_far(self) -> NeuralMap:
        learner, semantics = self._mapper.semantics, None
        if learner is not None:
            semantics = SemanticMap(learner.heads, learner.description)
        return NeuralMap(self._mapper.averaged, self._mapper.observed, semantics)

    def _emit(self, event: Event) -> None:
        self._tally.on_event(event)
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

    def _flush(self) -> None:
        self._ledger.flush()
        if self._telemetry is not None:
            self._telemetry.flush()

    def _write_checkpoint(self) -> None:
        """Keep all that a resumed run needs, ledger and telemetry first."""
        self._flush()
        segments = self._run.telemetry_segments() if self._telemetry is not None else []
        checkpoint = Checkpoint(
            turns=self._turns,
            steps=self._steps,
            ledger_lines=self._ledger.lines,
            telemetry_bytes=[segment.stat().st_size for segment in segments],
            camera_m=self._camera_m,
            simulation=asdict(self._tally),
            seconds=self._seconds,
            state=self._mapper.state(),
        )
        checkpoint.write(self._run.checkpoint)
        if self._config.keep_checkpoints:
            self._run.keep_checkpoint(self._turns)

    def _summary(self) -> dict[str, object]:
        return summary_of(
            self._turns, self._steps, self._mapper, self._map_so_far(), self._tally, self._seconds
        )

    def _finish(self, summary: dict[str, object]) -> None:
        """Give the results their final names, the map last: it says that the run is finished."""
        run = self._run
        replace(self._manifest, result=summary).write(run.manifest)
        if self._telemetry is not None:
            merge_segments(run.telemetry_segments(), run.telemetry)
        run.partial_ledger.replace(run.ledger)
        save_map(run.map, self._map_so_far())
        for segment in run.telemetry_segments():
            segment.unlink()
        run.checkpoint.unlink(missing_ok=True)
