"""Recovery: what is whole in a damaged or unfinished log becomes a log again."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO, TypeVar

import numpy as np
from mcap.writer import Writer

from proground_log.camera import Calibration, require_rigid
from proground_log.errors import ProgroundError
from proground_log.files import require_file, require_free, written_whole
from proground_log.frame import SensorFrame
from proground_log.locations import is_same
from proground_log.log import messages, topics
from proground_log.log.reader import FrameDecoder, MessageDecoder, RawMessage
from proground_log.log.recording import CHECKSUM, Origin, Recording, checksum
from proground_log.log.schemas import SENSOR_TYPES
from proground_log.log.task_record import TaskRecord
from proground_log.log.writer import start_mcap
from proground_log.perception.description import ATTACHMENT
from recorders.bounds import BoundsEstimator
from recorders.survey import Survey

SUFFIX = ".recovered.partial"
"""Not that of recording: the log to recover may bear that name."""

Known = TypeVar("Known")


@dataclass(frozen=True)
class Recovery:
    """What came of a recovery.

    Args:
        frames: frames saved.
        lost: frames that are known to have been in the log and are not saved.
        incomplete: those of them that there is something of.
        damage: the damaged places of the log, in words.
        notes: what else is lost or had to be assumed, by keyword.
    """

    frames: int
    lost: int
    incomplete: int
    damage: tuple[str, ...]
    notes: dict[str, str]

    def __str__(self) -> str:
        if not (self.damage or self.lost or self.notes):
            return f"{_counted(self.frames, 'frame')}; nothing was damaged"
        return (
            f"{_counted(self.frames, 'frame')}; {_counted(len(self.damage), 'damaged place')}, "
            f"{_counted(self.lost, 'frame')} lost, {self.incomplete} of them incomplete"
        )


def _counted(count: int, thing: str) -> str:
    return f"{count} {thing}{'s' * (count != 1)}"


def recover(
    log: Path, output: Path, *, overwrite: bool, progress: Callable[[int, int], None]
) -> Recovery:
    """Write the whole frames of a log into another one, each message byte for byte.

    The frames are numbered anew, and the bounds are theirs. What has no checksum that holds is
    left out.

    Args:
        log: the log, whole, damaged or unfinished; it is not changed.
        output: the log to write; takes its name once it is whole.
        overwrite: replace an output that is there.
        progress: told the frames done and the frames in all.

    Raises:
        ProgroundError: nothing can be saved, or the output is the log itself.
    """
    require_file(log)
    for path in (output, output.with_name(output.name + SUFFIX)):
        if is_same(path, log):
            what, todo = "the output is the log to recover", "choose another name"
            raise ProgroundError(what, where=output, todo=todo)
    require_free(output, overwrite=overwrite)
    with (
        log.open("rb") as stream,
        written_whole(output, suffix=SUFFIX) as temporary,
        temporary.open("wb") as target,
    ):
        return _Rebuilder(Survey(stream), log).write(target, progress)


class _Rebuilder:
    """Makes a log of a survey; raises a ProgroundError where there is too little."""

    def __init__(self, survey: Survey, log: Path) -> None:
        self._survey, self._log = survey, log
        self._notes: dict[str, str] = {}
        self._recording = self._known(topics.RECORDING_METADATA, Recording.from_metadata)
        origin = self._known(topics.ORIGIN_METADATA, Origin.from_metadata) or self._recording
        if origin is None:
            self._notes["origin"] = "lost"
            origin = Origin(log.stem, "unknown", {})
        self._origin = Origin(origin.source, origin.format, origin.notes)
        self._task = self._known(topics.TASK_METADATA, TaskRecord.from_metadata)
        if ATTACHMENT not in survey.attachments:
            self._task = None
        self._without = topics.PERCEPTION if self._task is None else frozenset[str]()
        seen = {channel.topic for channel in survey.channels.values()}
        if topics.REGIONS in seen and self._task is None:
            self._notes["perception"] = "left out, for what it looked for is lost"
        if topics.LABELS in seen and topics.LABEL_NAMES_ATTACHMENT not in survey.attachments:
            self._notes["label names"] = "lost"
        if survey.has_nameless:
            self._notes["topics"] = "one is left out, for what its messages are is lost"
        self._times_ns = survey.whole_frames(self._without)
        if not self._times_ns:
            raise self._nothing("no frame of a log is whole")
        self._mount = survey.mount()
        self._calibration = self._rig()

    def _nothing(self, why: str) -> ProgroundError:
        return ProgroundError(
            f"nothing can be saved: {why}", where=self._log, todo="record it again"
        )

    def _known(self, name: str, parse: Callable[..., Known]) -> Known | None:
        """A metadata record, where it is there and its checksum holds."""
        metadata = self._survey.metadata.get(name, {})
        if metadata.get(CHECKSUM) != checksum(metadata):
            return None
        return parse(metadata, where=self._log)

    def _rig(self) -> Calibration:
        """The cameras, as the first frame that is left has them."""
        group, decode = self._survey.messages(self._times_ns[0]), MessageDecoder()
        color, depth = (
            messages.camera(decode(schema, message, where=self._log), where=self._log)
            for schema, _, message in (group[topics.COLOR_INFO], group[topics.DEPTH_INFO])
        )
        if self._mount is None:
            topics_seen = {channel.topic for channel in self._survey.channels.values()}
            if color != depth or topics.TF_STATIC not in topics_seen:
                raise self._nothing("where its two cameras sit stood in a frame that is lost")
            self._notes["cameras"] = "assumed to be one; where they sit is lost"
            return Calibration.registered(color)
        schema, _, message = self._mount
        where = f"{self._log}, {topics.TF_STATIC}"
        mount = messages.parent_from_child(decode(schema, message, where=where), where=where)
        return Calibration(color, depth, require_rigid(mount, where=where))

    def write(self, target: BinaryIO, progress: Callable[[int, int], None]) -> Recovery:
        """Write the log."""
        survey = self._survey
        writer = start_mcap(target)
        writer.add_metadata(topics.ORIGIN_METADATA, self._origin.to_metadata())
        for name in survey.attachments:
            if name != ATTACHMENT or self._task is not None:
                kept = survey.attachment(name)
                times_ns = kept.create_time, kept.log_time
                writer.add_attachment(*times_ns, name, kept.media_type, kept.data)
        copy = _Copy(writer, survey, self._without)
        decode, estimator = FrameDecoder(self._calibration, where=self._log), BoundsEstimator()
        regions, unreadable = 0, []
        progress(0, len(self._times_ns))
        for done, time_ns in enumerate(self._times_ns, start=1):
            group = survey.messages(time_ns)
            raw = [item for topic, item in group.items() if copy.takes(topic)]
            try:
                frame = decode(copy.frames, raw)
                self._count(frame, estimator)
            except ProgroundError as error:
                unreadable.append(f"the frame of {time_ns / 1e9:.3f} s: {error.what}")
            else:
                if copy.frames == 0:
                    copy.write_mount(self._mount_message(time_ns), time_ns)
                copy.write(raw)
                regions += 0 if frame.regions is None else len(frame.regions.boxes)
            progress(done, len(self._times_ns))
        if copy.frames == 0:
            raise self._nothing(unreadable[0])
        recovery = self._recovery(copy.frames, unreadable)
        writer.add_metadata(
            topics.RECORDING_METADATA, self._new_recording(recovery, estimator).to_metadata()
        )
        if self._task is not None:
            task = replace(self._task, regions=regions)
            writer.add_metadata(topics.TASK_METADATA, task.to_metadata())
        writer.finish()
        return recovery

    def _count(self, frame: SensorFrame, estimator: BoundsEstimator) -> None:
        """Add a frame to the bounds; raises a ProgroundError for one that cannot be."""
        camera = (frame.calibration or self._calibration).depth
        if frame.depth.shape != (camera.height, camera.width):
            what, todo = "the depth image has not its camera's size", "record it again"
            raise ProgroundError(what, where=self._log, todo=todo)
        estimator.add(frame, camera)

    def _mount_message(self, time_ns: int) -> bytes:
        if self._mount is not None:
            return self._mount[2].data
        encode = messages.encoder(SENSOR_TYPES[topics.TF_STATIC])
        return encode(
            messages.transform_message(np.eye(4), time_ns, topics.DEPTH_FRAME, topics.COLOR_FRAME)
        )

    def _recovery(self, frames: int, unreadable: list[str]) -> Recovery:
        announced = self._recording.frames if self._recording is not None else 0
        return Recovery(
            frames=frames,
            lost=max(announced, self._survey.frames_seen) - frames,
            incomplete=self._survey.frames_found - frames,
            damage=(*self._survey.damage, *unreadable),
            notes=self._notes,
        )

    def _new_recording(self, recovery: Recovery, estimator: BoundsEstimator) -> Recording:
        known = self._recording
        try:
            bounds = estimator.bounds()
        except ProgroundError as error:
            raise self._nothing(error.what) from error
        return Recording(
            source=self._origin.source,
            format=self._origin.format,
            frames=recovery.frames,
            bounds=bounds,
            notes={**self._origin.notes, **self._notes, "recovered": str(recovery)},
            warnings=() if known is None else known.warnings,
        )


class _Copy:
    """Writes frames as they were, but for their numbers."""

    def __init__(self, writer: Writer, survey: Survey, without: frozenset[str]) -> None:
        self._writer = writer
        self.frames = 0
        schema_ids = {
            number: writer.register_schema(schema.name, schema.encoding, schema.data)
            for number, schema in sorted(survey.schemas.items())
        }
        self._channel_ids = {
            channel.topic: writer.register_channel(
                channel.topic,
                channel.message_encoding,
                schema_ids.get(channel.schema_id, 0),
                channel.metadata,
            )
            for _, channel in survey.channels.items()
            if channel.topic not in without
        }

    def takes(self, topic: str) -> bool:
        """Whether a frame's message is copied; where the cameras sit is not the frame's own."""
        return topic in self._channel_ids and topic != topics.TF_STATIC

    def write_mount(self, data: bytes, time_ns: int) -> None:
        """Say where the cameras sit, before the first frame."""
        self._add(topics.TF_STATIC, data, time_ns, time_ns)

    def write(self, group: Iterable[RawMessage]) -> None:
        """Append a frame."""
        for _, channel, message in group:
            self._add(channel.topic, message.data, message.log_time, message.publish_time)
        self.frames += 1

    def _add(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        self._writer.add_message(
            self._channel_ids[topic], log_time_ns, data, publish_time_ns, sequence=self.frames
        )
