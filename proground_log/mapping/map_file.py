"""The map on disk: all that rendering, meshing and querying need, in one safetensors file."""

from __future__ import annotations

import json
from pathlib import Path

from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from proground_log.errors import ProgroundError
from proground_log.files import require_file, written_whole
from proground_log.mapping.kinds import NEURAL, mapper_kind
from proground_log.mapping.map import Map

MAP_VERSION, BEFORE_KINDS = "3", "2"
"""What is written; and of version 0.1.0, which had one kind."""


def save_map(path: Path, content: Map) -> None:
    """Write a map, whole or not at all; the same map gives the same bytes."""
    header = {"version": MAP_VERSION, "kind": content.kind, **content.header()}
    with written_whole(path) as temporary:
        # One entry: safetensors writes several in any order.
        temporary.write_bytes(save(content.tensors(), {"proground.map": json.dumps(header)}))


def load_map(path: Path, device: str = "cpu") -> Map:
    """Read a map; raises a ProgroundError where the file is none, or of a kind nobody knows."""
    require_file(path)
    try:
        with safe_open(path, framework="numpy") as file:
            header = json.loads((file.metadata() or {}).get("proground.map", "{}"))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise ProgroundError(
            f"cannot be read as a map ({error})", where=path, todo="run the replay again"
        ) from error
    if header.get("version") not in (MAP_VERSION, BEFORE_KINDS):
        raise ProgroundError(
            f"has map version {header.get('version')}, this pglog reads {MAP_VERSION}",
            where=path,
            todo="run the replay again with this version of pglog",
        )
    kind = mapper_kind(header.get("kind", NEURAL))
    return kind.load(header, tensors, where=path, device=device)
