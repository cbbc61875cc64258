"""What a log says about its regions, for people; programs read the perception that is attached."""

from __future__ import annotations

import json
from dataclasses import dataclass

from proground_log.errors import ProgroundError
from proground_log.log.recording import CHECKSUM, checksum


@dataclass(frozen=True)
class TaskRecord:
    """The metadata record `proground.task`.

    Args:
        name: of the task.
        sha256: its fingerprint, hexadecimal.
        prompts: what was looked for, in the order of the regions' relevance.
        regions: how many regions were found in all frames.
    """

    name: str
    sha256: str
    prompts: tuple[str, ...]
    regions: int

    def to_metadata(self) -> dict[str, str]:
        """As MCAP keeps it: text by key."""
        metadata = {
            "name": self.name,
            "sha256": self.sha256,
            "prompts": json.dumps(self.prompts),
            "regions": str(self.regions),
        }
        return {**metadata, CHECKSUM: checksum(metadata)}

    @classmethod
    def from_metadata(cls, metadata: dict[str, str], *, where: object) -> TaskRecord:
        """Read it back; raises a ProgroundError where it is damaged."""
        try:
            if metadata[CHECKSUM] != checksum(metadata):
                raise ValueError("its checksum does not hold")
            return cls(
                name=metadata["name"],
                sha256=metadata["sha256"],
                prompts=tuple(json.loads(metadata["prompts"])),
                regions=int(metadata["regions"]),
            )
        except (KeyError, ValueError, TypeError, RecursionError) as error:
            raise ProgroundError(
                f"what it says about its task is damaged ({error})",
                where=where,
                todo="run `pglog perceive` again on the log that it was made of",
            ) from error
