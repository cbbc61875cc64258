"""Fingerprints of what goes into the mapper and of what it has become."""

from __future__ import annotations

import hashlib

import numpy as np

from proground_log.frame import Frame


def frame_digest(frame: Frame) -> str:
    """sha256 over all that a mapper gets to see of a frame, hexadecimal."""
    digest = hashlib.sha256()
    for array in (frame.world_from_camera, frame.depth_m, frame.color, frame.color_valid):
        digest.update(np.ascontiguousarray(array).data)
    if frame.regions is not None:
        for array in (*vars(frame.regions).values(), frame.region_of):
            digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def state_digests(state: dict[str, np.ndarray]) -> dict[str, str]:
    """sha256 of each array's bytes, by name, shortened to 32 hexadecimal digits."""
    return {
        name: hashlib.sha256(np.ascontiguousarray(array).data).hexdigest()[:32]
        for name, array in sorted(state.items())
    }
