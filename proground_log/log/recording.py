"""What a log says about itself."""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass

from proground_log.bounds import Bounds
from proground_log.errors import ProgroundError
from proground_log.log.topics import SCHEMA_VERSION

CHECKSUM = "crc32"


@dataclass(frozen=True)
class Recording:
    """The metadata record `proground.recording`.

    Args:
        source: name of the data set's folder or scene.
        format: the recorder that wrote the log.
        frames: number of frames.
        bounds: the box that the map should fill, world axes.
        notes: what the recorder had to leave out or assume, by keyword.
    """

    source: str
    format: str
    frames: int
    bounds: Bounds
    notes: dict[str, str]

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
        try:
            if metadata.get(CHECKSUM, expected := checksum(metadata)) != expected:
                raise ValueError("its checksum does not hold")
            return cls(
                source=metadata["source"],
                format=metadata["format"],
                frames=int(metadata["frames"]),
                bounds=Bounds(
                    tuple(json.loads(metadata["bounds_lower_m"])),
                    tuple(json.loads(metadata["bounds_upper_m"])),
                ),
                notes=json.loads(metadata["notes"]),
            )
        except (KeyError, ValueError, TypeError) as error:
            raise ProgroundError(
                f"its metadata is damaged ({error})", where=where, todo="record it again"
            ) from error


def checksum(metadata: dict[str, str]) -> str:
    """CRC-32 of all but the checksum itself; MCAP guards metadata only with the whole file."""
    content = sorted((key, text) for key, text in metadata.items() if key != CHECKSUM)
    return f"{zlib.crc32(json.dumps(content).encode()):08x}"
