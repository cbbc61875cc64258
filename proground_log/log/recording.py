"""What a log says about itself."""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from proground_log.bounds import Bounds
from proground_log.errors import ProgroundError
from proground_log.log.topics import SCHEMA_VERSION

CHECKSUM = "crc32"


@dataclass(frozen=True)
class Origin:
    """The metadata record `proground.origin`, which stands first, so that a crash leaves it.

    Args:
        source: name of the data set's folder or scene.
        format: the recorder that writes the log.
        notes: what the recorder knows from the start that it leaves out or assumes.
    """

    source: str
    format: str
    notes: dict[str, str]

    def to_metadata(self) -> dict[str, str]:
        """As MCAP keeps it: text by key."""
        notes = json.dumps(self.notes, sort_keys=True)
        metadata = {"source": self.source, "format": self.format, "notes": notes}
        return {**metadata, CHECKSUM: checksum(metadata)}

    @classmethod
    def from_metadata(cls, metadata: dict[str, str], *, where: object) -> Origin:
        """Read it back; raises a ProgroundError where it is damaged."""
        with _damage_named(metadata, where):
            return cls(metadata["source"], metadata["format"], dict(json.loads(metadata["notes"])))


@dataclass(frozen=True)
class Recording:
    """The metadata record `proground.recording`.

    Args:
        source: name of the data set's folder or scene.
        format: the recorder that wrote the log.
        frames: number of frames.
        bounds: the box that the map should fill, world axes.
        notes: what the recorder had to leave out or assume, by keyword.
        warnings: what looks wrong about the source, in sentences.
    """

    source: str
    format: str
    frames: int
    bounds: Bounds
    notes: dict[str, str]
    warnings: tuple[str, ...] = ()

    def to_metadata(self) -> dict[str, str]:
        """As MCAP keeps it: text by key."""
        metadata = {
            "schema_version": SCHEMA_VERSION,
            "source": self.source,
            "format": self.format,
            "frames": str(self.frames),
            "bounds_lower_m": json.dumps(self.bounds.lower_m),
            "bounds_upper_m": json.dumps(self.bounds.upper_m),
            "notes": json.dumps(self.notes, sort_keys=True),
            "warnings": json.dumps(self.warnings),
        }
        return {**metadata, CHECKSUM: checksum(metadata)}

    @classmethod
    def from_metadata(cls, metadata: dict[str, str], *, where: object) -> Recording:
        """Read it back; raises a ProgroundError where it is damaged or of another version."""
        version = metadata.get("schema_version")
        if version != SCHEMA_VERSION:
            raise ProgroundError(
                f"the log has schema version {version}, this pglog reads {SCHEMA_VERSION}",
                where=where,
                todo="record it again with this version of pglog",
            )
        with _damage_named(metadata, where):
            return cls(
                source=metadata["source"],
                format=metadata["format"],
                frames=int(metadata["frames"]),
                bounds=Bounds(
                    tuple(json.loads(metadata["bounds_lower_m"])),
                    tuple(json.loads(metadata["bounds_upper_m"])),
                ),
                notes=dict(json.loads(metadata["notes"])),
                warnings=tuple(json.loads(metadata.get("warnings", "[]"))),
            )


@contextmanager
def _damage_named(metadata: dict[str, str], where: object) -> Iterator[None]:
    """Verify a record's checksum, and name what else turns out to be wrong with it."""
    try:
        if metadata.get(CHECKSUM, expected := checksum(metadata)) != expected:
            raise ValueError("its checksum does not hold")
        yield
    except (KeyError, ValueError, TypeError, RecursionError) as error:
        raise ProgroundError(
            f"its metadata is damaged ({error})", where=where, todo="record it again"
        ) from error


def checksum(metadata: dict[str, str]) -> str:
    """CRC-32 of all but the checksum itself; MCAP guards metadata only with the whole file."""
    content = sorted((key, text) for key, text in metadata.items() if key != CHECKSUM)
    return f"{zlib.crc32(json.dumps(content).encode()):08x}"
