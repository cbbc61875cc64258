"""One replay in progress: turn by turn through the mapper, told to sinks as events."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Protocol

from proground_log.events import (
    FrameArrived,
    FrameDone,
    FrameDropped,
    FrameScheduled,
    MapperKnown,
    RegionsArrived,
    RunFinished,
    StateDigested,
    StepDone,
    TaskKnown,
)
from proground_log.frame import Frame, SensorFrame
from proground_log.log.reader import LogReader
from proground_log.log.registration import Registration
from proground_log.mapping.mapper import Mapper
from proground_log.perception.perceiver import Perceiver
from proground_log.run.folder import Checkpoint, RunFolder
from proground_log.run.settings import ReplayConfig
from proground_log.telemetry.pictures import Pictures
from replay.beside import FramesBeside
from replay.digests import frame_digest, state_digests
from replay.plan import Plan, Turn
from replay.scheduler import Drop, RegionsReady, Slot
from replay.sinks import Sinks
from replay.tally import summary_of


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
        run: where checkpoints go.
        config: the settings.
        plan: the turns of the frames.
        mapper: makes the map; at a checkpoint, where the replay goes on from one.
        sinks: where events go.
        perceiver: finds the regions, where the log has none.
        checkpoint: where an interrupted replay stood; None for a new one.
        until_frame: stop after this frame of the log; None: go on to the end.
        pause: asked after every frame.
    """

    def __init__(
        self,
        reader: LogReader,
        run: RunFolder,
        config: ReplayConfig,
        plan: Plan,
        mapper: Mapper,
        sinks: Sinks,
        *,
        perceiver: Perceiver | None = None,
        checkpoint: Checkpoint | None = None,
        until_frame: int | None = None,
        pause: Pause | None = None,
    ) -> None:
        self._reader, self._run, self._config, self._plan = reader, run, config, plan
        self._mapper, self._sinks, self._perceiver = mapper, sinks, perceiver
        self._until_frame, self._pause = until_frame, pause
        bounds = reader.recording.bounds
        self._pictures = Pictures(config.telemetry, bounds, mapper.description)
        self._register = Registration(reader.calibration)
        self._beside = FramesBeside()
        self._stop = threading.Event()
        self._turns = 0 if checkpoint is None else checkpoint.turns
        self._steps = 0 if checkpoint is None else checkpoint.steps
        self._camera_m = [] if checkpoint is None else checkpoint.camera_m

    def stop(self) -> None:
        """Stop after the frame at hand."""
        self._stop.set()

    def run(self) -> dict[str, object]:
        """Replay to the end; returns the summary.

        Raises:
            ReplayStoppedError: the user stopped it; there is a checkpoint to go on from.
        """
        self._introduce()
        self._go_through(list(self._plan.turns()))
        with self._sinks.timed("insert"):
            self._mapper.finish()
        self._digest()
        sinks = self._sinks
        steps = self._steps if self._plan.has_steps else None
        summary = summary_of(self._turns, steps, self._mapper, sinks.tally, sinks.seconds)
        sinks.emit(RunFinished(summary))
        return summary

    def checkpoint_after(self, frame: int, iteration: int) -> Checkpoint:
        """Replay up to a step in the middle of a frame, and no further.

        Args:
            frame: number of the frame in its log.
            iteration: number of the step in the frame, from 0.

        Raises:
            ProgroundError: the replay has no such step.
        """
        self._introduce()
        self._go_through(list(self._plan.turns_until(frame, iteration)), stops=False)
        return self._checkpoint()

    def _introduce(self) -> None:
        """Say what all that follows means."""
        description, task = self._mapper.description, None
        if description is not None:
            asked = description.task
            task = TaskKnown(asked.name, asked.all_prompts, asked.prompt_colors())
        counts = self._mapper.counts()
        self._sinks.emit(MapperKnown(self._config.kind, self._plan.has_steps, counts, task))

    def _go_through(self, turns: Sequence[Turn], *, stops: bool = True) -> None:
        """Take all turns that are still to come."""
        if self._plan.policy.beside:
            self._beside.recall(turns[: self._turns], self._reader, self._perceived)
        ahead = turns[self._turns :]
        for turn, sensor in zip(ahead, self._sensor_frames(ahead), strict=True):
            self._take_turn(turn, sensor, is_last=self._turns + 1 == len(turns))
            if stops and self._turns < len(turns):
                self._after_frame(turn, len(turns))

    def _sensor_frames(self, turns: Sequence[Turn]) -> Iterator[SensorFrame]:
        frames = self._reader.frames([turn.frame for turn in turns]) if turns else iter(())
        while True:
            with self._sinks.timed("decode"):
                sensor = next(frames, None)
            if sensor is None:
                return
            yield sensor

    def _take_turn(self, turn: Turn, sensor: SensorFrame, *, is_last: bool) -> None:
        """One frame's whole way: arrival, insertion, steps, telemetry."""
        slot = turn.slot
        if slot is None:
            frame = self._registered(replace(sensor, regions=None))
            self._announce(frame, turn.sim_time_ns, held_out=True)
            self._close_frame(frame.index, 0, turn.sim_time_ns)
        else:
            frame = self._map_frame(slot, sensor)
        self._turns += 1
        if self._config.telemetry.enabled and (is_last or slot is not None):
            self._render_views(frame, is_last=is_last)

    def _map_frame(self, slot: Slot, sensor: SensorFrame) -> Frame:
        """All that happens in a slot; returns the frame as the mapper saw it."""
        happened = deque(slot.meanwhile)
        self._announce_until(slot.begin_ns, happened)
        if slot.is_perceived:
            frame = self._perceived(sensor)
            if self._plan.policy.beside:
                self._beside.add(frame)
                frame = replace(frame, regions=None, region_of=None)
        else:
            frame = self._registered(replace(sensor, regions=None))
        self._announce(frame, slot.begin_ns, held_out=False)
        with self._sinks.timed("insert"):
            inserted = self._mapper.insert(frame, is_keyframe=slot.is_keyframe)
        for event in inserted:
            self._sinks.emit(event)
        done = self._do_steps(slot, happened)
        self._announce_until(slot.end_ns, happened)
        self._sinks.emit(
            FrameScheduled(
                frame_index=slot.frame,
                sim_time_ns=slot.end_ns,
                arrived_ns=slot.arrived_ns,
                idle_ns=slot.begin_ns - self._sinks.tally.end_ns,
                waiting=slot.waiting,
                steps=slot.steps,
                overrun_ns=slot.overrun_ns,
                spans=self._plan.spans(slot),
            )
        )
        self._close_frame(slot.frame, done, slot.end_ns)
        return frame

    def _registered(self, sensor: SensorFrame) -> Frame:
        with self._sinks.timed("decode"):
            return self._register(sensor)

    def _perceived(self, sensor: SensorFrame) -> Frame:
        """The frame with its regions, from the log or from the perceiver."""
        if self._perceiver is not None:
            with self._sinks.timed("perceive"):
                sensor = replace(sensor, regions=self._perceiver(sensor))
        return self._registered(sensor)

    def _announce(self, frame: Frame, sim_time_ns: int, *, held_out: bool) -> None:
        self._camera_m = frame.world_from_camera[:3, 3].tolist()
        with self._sinks.timed("ledger"):
            digest = frame_digest(frame)
        self._sinks.emit(FrameArrived(frame, sim_time_ns, digest, held_out))

    def _announce_until(self, until_ns: int, happened: deque[Drop | RegionsReady]) -> None:
        """Tell what happened beside the mapper up to a moment; regions that came are learnt."""
        while happened and happened[0].at_ns <= until_ns:
            event = happened.popleft()
            if isinstance(event, Drop):
                self._sinks.emit(FrameDropped(event.frame, event.at_ns, event.reason))
                continue
            with self._sinks.timed("insert"):
                self._mapper.insert_regions(self._beside.take(event.frame))
            self._sinks.emit(RegionsArrived(event.frame, event.begin_ns, event.at_ns))

    def _do_steps(self, slot: Slot, happened: deque[Drop | RegionsReady]) -> int:
        """The optimisation steps of a frame; how many there was something to learn for."""
        step_ns = self._plan.timing.step_ns
        first_ns = slot.end_ns - slot.steps * step_ns
        self._announce_until(first_ns, happened)
        tried = done = 0
        while tried < slot.steps:
            # As many at once as there are until something has to be done between two of them: a
            # fingerprint, or regions to learn. What comes during a step counts from the next on.
            count = min(
                slot.steps - tried,
                self._config.digest_every - self._steps % self._config.digest_every,
            )
            arriving = next((event for event in happened if isinstance(event, RegionsReady)), None)
            if arriving is not None:
                during = -(-(arriving.at_ns - first_ns) // step_ns)
                count = max(1, min(count, during - tried))
            with self._sinks.timed("step"):
                results = self._mapper.steps(count)
            for result in results:
                tried += 1
                sim_time_ns = first_ns + tried * step_ns
                self._announce_until(sim_time_ns, happened)
                self._sinks.emit(
                    StepDone(
                        frame_index=slot.frame,
                        step=self._steps,
                        iteration=tried - 1,
                        sim_time_ns=sim_time_ns,
                        losses=result.losses,
                        draws_digest=result.draws_digest,
                    )
                )
                done += 1
                self._steps += 1
            if results and self._steps % self._config.digest_every == 0:
                self._digest()
            if len(results) < count:
                tried += count - len(results)
                self._announce_until(first_ns + tried * step_ns, happened)
        return done

    def _digest(self) -> None:
        with self._sinks.timed("ledger"):
            digests = state_digests(self._mapper.state())
        self._sinks.emit(StateDigested(self._steps, digests))

    def _close_frame(self, frame_index: int, steps: int, sim_time_ns: int) -> None:
        counts = self._mapper.counts()
        self._sinks.emit(FrameDone(frame_index, steps, sim_time_ns, counts))
        # Where there are no steps, frames are counted from one fingerprint to the next.
        if not self._plan.has_steps and (self._turns + 1) % self._config.digest_every == 0:
            self._digest()

    def _after_frame(self, turn: Turn, total: int) -> None:
        """After a frame that is not the last: checkpoints, pauses, stops."""
        is_wanted = self._until_frame is not None and turn.frame >= self._until_frame
        if self._pause is not None and self._pause.wants(turn.frame):
            self._sinks.flush()
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

    def _checkpoint(self) -> Checkpoint:
        return self._sinks.checkpoint(
            self._turns, self._steps, self._camera_m, self._mapper.state()
        )

    def _write_checkpoint(self) -> None:
        self._checkpoint().write(self._run.checkpoint)
        if self._config.keep_checkpoints:
            self._run.keep_checkpoint(self._turns)

    def _render_views(self, frame: Frame, *, is_last: bool) -> None:
        """Render what telemetry wants to see of this frame."""
        telemetry, sinks = self._config.telemetry, self._sinks
        number = sinks.tally.mapped - 1
        if is_last or number % telemetry.view_every == 0:
            with sinks.timed("views"):
                view = self._pictures.view(self._mapper.map(), frame)
            sinks.emit(view)
            with sinks.timed("views"):
                scores = self._mapper.scores(frame.index)
            if scores is not None:
                sinks.emit(scores)
        if is_last or number % telemetry.mesh_every == telemetry.mesh_every - 1:
            with sinks.timed("views"):
                mesh = self._pictures.mesh(self._mapper.map(), frame.index)
            sinks.emit(mesh)
