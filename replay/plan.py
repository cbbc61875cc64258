"""What a replay is going to do, known before it begins: its frames and their schedule."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from proground_log.camera import Calibration
from proground_log.errors import ProgroundError
from proground_log.log.reader import LogReader
from proground_log.mapping.kinds import mapper_kind
from proground_log.run.cost_model import CostModel
from proground_log.run.settings import ReplayConfig
from replay.scheduler import Policy, Slot, Timing, schedule

NS_PER_MS = 1_000_000


class Turn(NamedTuple):
    """A frame that is read: mapped in its slot, or held out for evaluation.

    Args:
        frame: its number.
        sim_time_ns: when it is read, in simulated time.
        slot: what it gets; None where it is held out.
    """

    frame: int
    sim_time_ns: int
    slot: Slot | None


class Plan:
    """The frames that arrive, and the turns that they get.

    Held-out frames are kept from the mapper before anything else: they cost no time and no place
    in the queue.

    Args:
        reader: the log.
        config: the settings.
        cost_model: what each stage takes.
        learns: whether frames have regions, and meaning is learnt from them.

    Raises:
        ProgroundError: a setting that makes no sense, a stage that the cost model does not have.
    """

    def __init__(
        self,
        reader: LogReader,
        config: ReplayConfig,
        cost_model: CostModel,
        *,
        learns: bool,
    ) -> None:
        scale = config.simulation.cost_scale
        self._machine = cost_model.name + (f" at --cost-scale {scale:g}" if scale != 1 else "")
        self.chosen = config.selection.of(len(reader))[: config.max_frames]
        self.policy = _policy(config)
        self.timing = _timing(reader.calibration, config, cost_model, learns=learns)
        self.held_out = config.held_out(len(reader))
        self._arrivals_ns = self._arrivals(reader, config)

    def _arrivals(self, reader: LogReader, config: ReplayConfig) -> dict[int, int]:
        """When each frame arrives; in lock-step nobody asks."""
        if self.policy.lock_step:
            return dict.fromkeys(self.chosen, 0)
        stamps_ns = reader.stamps_ns()
        start_ns = stamps_ns[self.chosen[0]]
        rate = config.simulation.speed
        return {frame: round((stamps_ns[frame] - start_ns) / rate) for frame in self.chosen}

    def turns(self) -> Iterator[Turn]:
        """All turns, in order of time."""
        held = set(self.held_out)
        mapped = [frame for frame in self.chosen if frame not in held]
        held_out = iter([*self.held_out, None])
        arrivals_ns = [self._arrivals_ns[frame] for frame in mapped]
        following, now_ns = next(held_out), 0
        for slot in schedule(mapped, arrivals_ns, self.timing, self.policy):
            while following is not None and following < slot.frame:
                now_ns = max(now_ns, self._arrivals_ns[following])
                yield Turn(following, min(now_ns, slot.begin_ns), None)
                following = next(held_out)
            yield Turn(slot.frame, slot.begin_ns, slot)
            now_ns = slot.end_ns
        while following is not None:
            now_ns = max(now_ns, self._arrivals_ns[following])
            yield Turn(following, now_ns, None)
            following = next(held_out)

    @property
    def has_steps(self) -> bool:
        """Whether the mapper optimises, so that frames get steps."""
        return self.timing.step_ns > 0

    def turns_until(self, frame: int, iteration: int) -> Iterator[Turn]:
        """The turns up to a step in the middle of a frame, which ends there.

        Raises:
            ProgroundError: there is no such step.
        """
        for turn in self.turns():
            if turn.frame == frame and turn.slot is not None and iteration < turn.slot.steps:
                yield turn._replace(slot=self._cut(turn.slot, iteration + 1))
                return
            yield turn
        raise ProgroundError(
            f"there is no step {iteration} of frame {frame} in this replay",
            where="--until-step",
            todo="see the run's ledger for its frames and their steps",
        )

    def _cut(self, slot: Slot, steps: int) -> Slot:
        step_ns = self.timing.step_ns
        last_ns = slot.end_ns - (slot.steps - steps + 1) * step_ns
        return slot._replace(
            steps=steps,
            end_ns=last_ns + step_ns,
            meanwhile=tuple(event for event in slot.meanwhile if event.at_ns <= last_ns),
        )

    def warning(self) -> str | None:
        """What to tell the user before a replay whose budget never holds a step; None otherwise."""
        slots = [turn.slot for turn in self.turns() if turn.slot is not None]
        budget_ns, step_ns = self.policy.budget_ns, self.timing.step_ns
        if budget_ns is None or not self.has_steps or not slots or any(s.steps for s in slots):
            return None
        cheapest = min(slots, key=lambda slot: slot.end_ns - slot.begin_ns)
        rest_ns = cheapest.end_ns - cheapest.begin_ns
        perceiving = ", perceiving" if "perceive" in self.spans(cheapest) else ""
        return (
            f"--budget-ms {budget_ns / NS_PER_MS:g}: no step fits (one takes "
            f"{step_ns / NS_PER_MS:.1f} ms by {self._machine}, reading{perceiving} and inserting "
            f"{rest_ns / NS_PER_MS:.1f} ms); the map will learn nothing; "
            f"give {-(-(rest_ns + step_ns) // NS_PER_MS)} or more"
        )

    def spans(self, slot: Slot) -> dict[str, tuple[int, int]]:
        """Begin and end of each stage of a slot, in nanoseconds; none of those without length."""
        lengths = {"decode": self.timing.decode_ns}
        lengths["insert"] = self.timing.insert_ns + self.timing.learn_ns * slot.is_perceived
        if slot.is_perceived and not self.policy.beside:
            lengths["perceive"] = self.timing.perceive_ns
        lengths["step"] = slot.steps * self.timing.step_ns
        begin_ns, spans = slot.begin_ns, {}
        for stage in ("decode", "perceive", "insert", "step"):
            if lengths.get(stage):
                spans[stage] = begin_ns, begin_ns + lengths[stage]
                begin_ns += lengths[stage]
        return spans


def _policy(config: ReplayConfig) -> Policy:
    simulation = config.simulation
    simulation.require_sound()
    least = {"steps": 0, "digest_every": 1, "checkpoint_every": 1}
    for name, bound in least.items():
        if getattr(config, name) < bound:
            flag = f"--{name.replace('_', '-')}"
            value = getattr(config, name)
            raise ProgroundError(f"cannot be {value}", where=flag, todo=f"give {bound} or more")
    return Policy(
        budget_ns=None if simulation.budget_ms is None else round(simulation.budget_ms * NS_PER_MS),
        steps=config.steps,
        lock_step=simulation.speed == 0,
        queue=simulation.queue,
        overrun=simulation.overrun,
        keyframe_every=simulation.keyframe_every,
        perceive_every=simulation.perceive_every,
        keyframes_only=simulation.perceive_keyframes_only,
        beside=simulation.perceive_beside,
    )


def _timing(
    calibration: Calibration, config: ReplayConfig, cost_model: CostModel, *, learns: bool
) -> Timing:
    color, depth = calibration.color, calibration.depth
    depth_pixels = depth.width * depth.height
    work = mapper_kind(config.kind).work(config.mapper, depth_pixels, learns=learns)
    perception = {"perceive": 1, **work.regions} if learns else {}
    decode = {"decode": color.width * color.height + depth_pixels}
    cost_model.require((*decode, *work.insert, *work.step, *perception))

    def total_ns(units: Mapping[str, int]) -> int:
        return sum(cost_model.cost_ns(stage, count) for stage, count in units.items())

    return Timing(
        decode_ns=total_ns(decode),
        perceive_ns=cost_model.cost_ns("perceive", 1) if learns else 0,
        insert_ns=total_ns(work.insert),
        step_ns=total_ns(work.step),
        learn_ns=total_ns(work.regions) if learns else 0,
    )
