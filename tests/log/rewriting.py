"""Logs that no LogWriter would write: a good one, message by message, with something changed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory

from proground_log.log.messages import encoder

Edit = Callable[[str, int, Any], Any]


def rewrite(
    source: Path,
    target: Path,
    edit: Edit = lambda _topic, _frame, message: message,
    *,
    log_time_ns: Callable[[int, int], int] = lambda _frame, time_ns: time_ns,
    metadata: Callable[[dict[str, str]], dict[str, str]] = dict,
    chunk_bytes: int = 2**21,
) -> Path:
    """Copy a log.

    Args:
        source, target: the logs.
        edit: given topic, frame number and message, what to write: the message, changed or not,
            bytes in its place, or None to leave it out.
        log_time_ns: given frame number and time, the time to write.
        metadata: given what the log says about itself, what to say.
        chunk_bytes: size of the chunks.
    """
    with source.open("rb") as stream, target.open("wb") as output:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        writer = Writer(
            output,
            chunk_size=chunk_bytes,
            compression=CompressionType.ZSTD,
            enable_data_crcs=True,
        )
        writer.start(profile="ros2", library="test")
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert schema is not None
            edited = edit(channel.topic, message.sequence, decoded)
            if edited is None:
                continue
            if schema.name not in schemas:
                schemas[schema.name] = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            if channel.topic not in channels:
                channels[channel.topic] = writer.register_channel(
                    channel.topic, "cdr", schemas[schema.name]
                )
            time_ns = log_time_ns(message.sequence, message.log_time)
            writer.add_message(
                channels[channel.topic],
                log_time=time_ns,
                publish_time=time_ns,
                sequence=message.sequence,
                data=edited if isinstance(edited, bytes) else encoder(schema.name)(edited),
            )
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, metadata(record.metadata))
        for attachment in reader.iter_attachments():
            writer.add_attachment(
                attachment.create_time,
                attachment.log_time,
                attachment.name,
                attachment.media_type,
                attachment.data,
            )
        writer.finish()
    return target
