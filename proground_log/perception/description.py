"""What made the regions of a log: task, texts and heads, kept with them."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from proground_log.errors import ProgroundError
from proground_log.perception.heads import TextHeads
from proground_log.perception.task import Task

ATTACHMENT = "perception.safetensors"
"""Its name in a log."""
_HEADS = ("scale", "shift", "logit_scale", "bias")


@dataclass(frozen=True)
class PerceptionDescription:
    """All that is needed to ask the regions, and a map made of them, for a text.

    Args:
        task: what was looked for.
        texts: float32 [K, 512], the embedding of each prompt, of length 1.
        heads: the detector's.
        origin: what produced the regions, by keyword: kind, files, their sha256.
    """

    task: Task
    texts: np.ndarray
    heads: TextHeads
    origin: dict[str, str]

    def to_bytes(self) -> bytes:
        """As a log and a map keep it; equal descriptions give equal bytes."""
        tensors = {f"heads.{name}": getattr(self.heads, name) for name in _HEADS}
        header = {"task": self.task.to_json(), "origin": self.origin}
        return save(
            {**tensors, "texts": np.ascontiguousarray(self.texts, np.float32)},
            # One entry: safetensors writes several in any order.
            {"proground.perception": json.dumps(header, sort_keys=True)},
        )

    @classmethod
    def from_bytes(cls, data: bytes, *, where: object) -> PerceptionDescription:
        """Read it back; raises a ProgroundError where it is damaged."""
        try:
            length = int.from_bytes(data[:8], "little")
            header = json.loads(
                json.loads(data[8 : 8 + length])["__metadata__"]["proground.perception"]
            )
            tensors = load(data)
            return cls(
                task=Task.from_json(header["task"], where=where),
                texts=tensors["texts"],
                heads=TextHeads(*(tensors[f"heads.{name}"] for name in _HEADS)),
                origin=header["origin"],
            )
        except (SafetensorError, KeyError, ValueError, TypeError) as error:
            raise ProgroundError(
                f"its perception cannot be read ({error})",
                where=where,
                todo="run `pglog perceive` again",
            ) from error


def fingerprint(perception: PerceptionDescription | None) -> str | None:
    """sha256 of all that perception says of itself, hexadecimal."""
    return None if perception is None else hashlib.sha256(perception.to_bytes()).hexdigest()
