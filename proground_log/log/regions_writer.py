"""Writes a log anew, every message as it was, with regions in it."""

from __future__ import annotations

from typing import BinaryIO

from mcap.well_known import MessageEncoding

from proground_log.log import topics
from proground_log.log.messages import REGIONS_TYPE
from proground_log.log.reader import LogReader, RawMessage
from proground_log.log.schemas import PERCEPTION_TYPES
from proground_log.log.task_record import TaskRecord
from proground_log.log.writer import register_schema, start_mcap


class RegionsWriter:
    """Copies a log and adds regions.

    Args:
        stream: where to write.
        source: the log.
    """

    def __init__(self, stream: BinaryIO, source: LogReader) -> None:
        self._source = source
        self._writer = start_mcap(stream)
        schema_ids = {0: 0}  # MCAP's number of "no schema".
        by_name: dict[str, int] = {}
        for number, schema in sorted(source.schemas.items()):
            if schema.name != REGIONS_TYPE:
                added = self._writer.register_schema(schema.name, schema.encoding, schema.data)
                schema_ids[number] = by_name[schema.name] = added
        self._channel_ids = {
            number: self._writer.register_channel(
                channel.topic,
                channel.message_encoding,
                schema_ids[channel.schema_id],
                channel.metadata,
            )
            for number, channel in sorted(source.channels.items())
            if channel.topic not in topics.PERCEPTION
        }
        self._added_ids = {
            topic: self._writer.register_channel(
                topic,
                MessageEncoding.CDR,
                by_name.get(name) or register_schema(self._writer, name),
            )
            for topic, name in PERCEPTION_TYPES.items()
        }
        self._last_stamp_ns = 0

    def write(self, group: list[RawMessage], regions: bytes, preview: bytes) -> None:
        """Append a frame.

        Args:
            group: its messages, without those of an earlier perception.
            regions, preview: the messages to add, encoded.
        """
        for _, channel, message in group:
            self._writer.add_message(
                self._channel_ids[channel.id],
                log_time=message.log_time,
                publish_time=message.publish_time,
                sequence=message.sequence,
                data=message.data,
            )
        _, _, first = group[0]
        self._last_stamp_ns = first.log_time
        for topic, data in ((topics.REGIONS, regions), (topics.REGIONS_PREVIEW, preview)):
            self._writer.add_message(
                self._added_ids[topic],
                log_time=first.log_time,
                publish_time=first.log_time,
                sequence=first.sequence,
                data=data,
            )

    def finish(self, task: TaskRecord, attachment_name: str, attachment: bytes) -> None:
        """Write what the source knows, the task and the perception to attach, and the index."""
        metadata = {**self._source.metadata, topics.TASK_METADATA: task.to_metadata()}
        for name, content in metadata.items():
            self._writer.add_metadata(name, content)
        for index in self._source.attachments:
            data = self._source.attachment(index.name)
            if index.name != attachment_name and data is not None:
                self._writer.add_attachment(
                    index.create_time, index.log_time, index.name, index.media_type, data
                )
        self._writer.add_attachment(
            self._last_stamp_ns,
            self._last_stamp_ns,
            attachment_name,
            "application/octet-stream",
            attachment,
        )
        self._writer.finish()
