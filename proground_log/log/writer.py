"""Writes sensor frames into an MCAP log, the same bytes for the same frames."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import cv2
import numpy as np
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, Writer

from proground_log.camera import Calibration
from proground_log.errors import ProgroundError
from proground_log.files import written_whole
from proground_log.frame import SensorFrame
from proground_log.log import messages, topics
from proground_log.log.recording import Origin, Recording
from proground_log.log.schemas import SENSOR_TYPES
from proground_log.palette import label_colors

CHUNK_BYTES = 2 * 1024 * 1024


def start_mcap(stream: BinaryIO) -> Writer:
    """A writer of MCAP as every log is written: ROS 2 profile, zstd chunks, all checksums."""
    writer = Writer(
        stream,
        chunk_size=CHUNK_BYTES,
        compression=CompressionType.ZSTD,
        enable_crcs=True,
        enable_data_crcs=True,
    )
    writer.start(profile="ros2", library="proground-log")
    return writer


def register_schema(writer: Writer, message_type: str) -> int:
    """Add the definition of one of our message types; returns its number."""
    definition = messages.DEFINITIONS[message_type].encode()
    return writer.register_schema(message_type, SchemaEncoding.ROS2, definition)


class LogWriter:
    """Writes one log; made by `open_writer`. Regions come later, by `RegionsWriter`.

    All messages of a frame carry the frame's time as log time, so that equal times mean one
    frame; the images' headers keep the sensors' own times. What is known from the start stands
    first, and the file is brought up to date at least every second of the recording: whatever
    stops a recorder, `pglog recover` finds all the rest.

    Args:
        stream: where to write.
        calibration: the cameras.
        origin: what the log is of.
        label_names: class names by label; empty without ground truth.
        mesh: the labelled ground-truth mesh as binary PLY, where there is one.
    """

    def __init__(
        self,
        stream: BinaryIO,
        calibration: Calibration,
        origin: Origin,
        label_names: dict[int, str],
        mesh: bytes | None,
    ) -> None:
        self._stream = stream
        self._calibration = calibration
        self._writer = start_mcap(stream)
        self._writer.add_metadata(topics.ORIGIN_METADATA, origin.to_metadata())
        names = json.dumps({str(label): name for label, name in sorted(label_names.items())})
        self._attach(topics.LABEL_NAMES_ATTACHMENT, "application/json", names.encode())
        if mesh is not None:
            self._attach(topics.MESH_ATTACHMENT, "application/x-ply", mesh)
        types = [name for name in messages.DEFINITIONS if name in SENSOR_TYPES.values()]
        self._encoders = {name: messages.encoder(name) for name in types}
        self._schema_ids = {name: register_schema(self._writer, name) for name in types}
        self._camera_infos = self._encoded_infos(calibration)
        self._channel_ids: dict[str, int] = {}
        self._frames = 0
        self._last_stamp_ns = -1
        self._frames_saved, self._written_bytes = 0, 0
        self._flushed_second = -1
        self._is_finished = False

    @property
    def frames(self) -> int:
        """Frames written so far."""
        return self._frames

    @property
    def frames_saved(self) -> int:
        """Frames that the file holds whole by now, whatever happens next."""
        return self._frames_saved

    @property
    def is_finished(self) -> bool:
        """Whether `finish` was called."""
        return self._is_finished

    def write(self, frame: SensorFrame) -> None:
        """Append a frame; its time has to be later than that of the one before."""
        stamp_ns = frame.stamp_ns
        if stamp_ns <= self._last_stamp_ns:
            raise ProgroundError(
                f"its time, {stamp_ns} ns, is not after {self._last_stamp_ns} ns",
                where=f"frame {frame.index}",
                todo="put the source's frames in order of time",
            )
        cameras, infos = self._calibration, self._camera_infos
        if frame.calibration is not None:
            cameras, infos = frame.calibration, self._encoded_infos(frame.calibration)
        for pixels, camera, what in (
            (frame.depth, cameras.depth, "depth image"),
            (frame.labels, cameras.color, "label image"),
            (frame.instances, cameras.color, "instance image"),
        ):
            if pixels is not None and pixels.shape != (camera.height, camera.width):
                raise ProgroundError(
                    f"the {what} is {pixels.shape[1]}x{pixels.shape[0]}, "
                    f"the camera {camera.width}x{camera.height}",
                    where=f"frame {frame.index}",
                    todo="bring the source's images and its calibration together",
                )
        self._last_stamp_ns = stamp_ns
        if self._frames == 0:
            self._name_topics(frame)
            mount = messages.transform_message(
                self._calibration.depth_from_color, stamp_ns, topics.DEPTH_FRAME, topics.COLOR_FRAME
            )
            self._add(topics.TF_STATIC, stamp_ns, mount)
        pose = messages.transform_message(
            frame.world_from_camera, stamp_ns, topics.WORLD_FRAME, topics.DEPTH_FRAME
        )
        self._add(topics.TF, stamp_ns, pose)
        for topic, encoded in infos.items():
            self._add_encoded(topic, stamp_ns, messages.restamped(encoded, stamp_ns))
        color = messages.compressed_image(
            frame.color, frame.color_format, frame.color_stamp_ns, topics.COLOR_FRAME
        )
        self._add(topics.COLOR, stamp_ns, color)
        encoding = "16UC1" if frame.depth.dtype == np.uint16 else "32FC1"
        depth = messages.image(frame.depth, encoding, stamp_ns, topics.DEPTH_FRAME)
        self._add(topics.DEPTH, stamp_ns, depth)
        if frame.labels is not None:
            self._write_labels(frame.labels, stamp_ns)
        if frame.instances is not None:
            exact = messages.image(frame.instances, "mono16", stamp_ns, topics.COLOR_FRAME)
            self._add(topics.INSTANCES, stamp_ns, exact)
        self._frames += 1
        is_flushed = stamp_ns // 1_000_000_000 != self._flushed_second
        if is_flushed:
            self._flushed_second = stamp_ns // 1_000_000_000
            self._writer.flush()
        self._stream.flush()
        if is_flushed:
            self._frames_saved = self._frames
        elif self._stream.tell() > self._written_bytes:
            # A chunk was full: the frames before this one are in it, perhaps not all of this one.
            self._frames_saved = self._frames - 1
        self._written_bytes = self._stream.tell()

    def _encoded_infos(self, calibration: Calibration) -> dict[str, bytes]:
        """Messages that mostly differ between frames in their time alone, slow to encode."""
        encode = self._encoders["sensor_msgs/msg/CameraInfo"]
        return {
            topic: encode(messages.camera_info(camera, 0, frame_id))
            for topic, camera, frame_id in (
                (topics.COLOR_INFO, calibration.color, topics.COLOR_FRAME),
                (topics.DEPTH_INFO, calibration.depth, topics.DEPTH_FRAME),
            )
        }

    def _write_labels(self, labels: np.ndarray, stamp_ns: int) -> None:
        exact = messages.image(labels, "mono16", stamp_ns, topics.COLOR_FRAME)
        self._add(topics.LABELS, stamp_ns, exact)
        colored = label_colors(int(labels.max()) + 1)[labels]
        _, png = cv2.imencode(".png", colored[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 1])
        preview = messages.compressed_image(png.tobytes(), "png", stamp_ns, topics.COLOR_FRAME)
        self._add(topics.LABELS_PREVIEW, stamp_ns, preview)

    def _name_topics(self, first: SensorFrame) -> None:
        """Put what is known of the topics into the first chunk, however large the frame is."""
        known = [topics.TF_STATIC, topics.TF, *self._camera_infos, topics.COLOR, topics.DEPTH]
        known += [topics.LABELS, topics.LABELS_PREVIEW] * (first.labels is not None)
        known += [topics.INSTANCES] * (first.instances is not None)
        for topic in known:
            self._channel_id(topic)

    def _channel_id(self, topic: str) -> int:
        """The number of a topic's channel, which is made when it is first asked for."""
        if topic not in self._channel_ids:
            metadata = {}
            if topic == topics.TF_STATIC:
                # What a ROS 2 player needs to hand a static transform to late listeners.
                metadata["offered_qos_profiles"] = "- durability: transient_local"
            self._channel_ids[topic] = self._writer.register_channel(
                topic, MessageEncoding.CDR, self._schema_ids[SENSOR_TYPES[topic]], metadata
            )
        return self._channel_ids[topic]

    def _add(self, topic: str, stamp_ns: int, message: object) -> None:
        self._add_encoded(topic, stamp_ns, self._encoders[SENSOR_TYPES[topic]](message))

    def _add_encoded(self, topic: str, stamp_ns: int, data: bytes) -> None:
        self._writer.add_message(
            self._channel_id(topic),
            log_time=stamp_ns,
            publish_time=stamp_ns,
            sequence=self._frames,
            data=data,
        )

    def finish(self, recording: Recording) -> None:
        """Write what is known at the end, and the index."""
        self._writer.add_metadata(topics.RECORDING_METADATA, recording.to_metadata())
        self._writer.finish()
        self._is_finished = True

    def _attach(self, name: str, media_type: str, data: bytes) -> None:
        self._writer.add_attachment(0, 0, name, media_type, data)


@contextmanager
def open_writer(
    path: Path,
    calibration: Calibration,
    origin: Origin,
    label_names: dict[int, str],
    mesh: bytes | None,
) -> Iterator[LogWriter]:
    """Write a log to `path`, which takes its name only once `LogWriter.finish` was called.

    Where the user, the disk or the source stops it, what was written stays, for `pglog recover`.
    """
    stops = (KeyboardInterrupt, OSError, ProgroundError)
    with written_whole(path, kept_on=stops) as temporary, temporary.open("wb") as stream:
        writer = LogWriter(stream, calibration, origin, label_names, mesh)
        yield writer
        if not writer.is_finished:
            raise RuntimeError(f"{path} was not finished")
