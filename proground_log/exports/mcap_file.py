"""MCAP: a map's surface and the objects on it, as ROS 2 tools, Foxglove and rerun show them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from mcap.well_known import MessageEncoding, SchemaEncoding

from proground_log.exports.labels import SurfaceLabels
from proground_log.exports.ros_messages import (
    DEFINITIONS,
    MARKERS_TYPE,
    POINT_CLOUD_TYPE,
    box_markers,
    encoder,
    point_cloud,
)
from proground_log.files import written_whole
from proground_log.log.topics import LABEL_NAMES_ATTACHMENT, WORLD_FRAME
from proground_log.log.writer import start_mcap
from proground_log.mapping.objects import SceneObject
from proground_log.query.mesh import Mesh

SURFACE, OUTLINES, OBJECTS = "/map/surface", "/map/object_outlines", "/map/objects"
_TYPES = {SURFACE: POINT_CLOUD_TYPE, OUTLINES: POINT_CLOUD_TYPE, OBJECTS: MARKERS_TYPE}
OUTLINE_STEP_M = 0.01
"""Between the points of an outline: rerun shows clouds of points, but no markers."""
_EDGES = [(a, b) for a in range(8) for b in range(8) if a < b and (a ^ b) in (1, 2, 4)]
"""Corners of a box that an edge joins: those whose numbers differ in one bit."""


def write_mcap(
    path: Path,
    mesh: Mesh,
    labels: SurfaceLabels,
    objects: Sequence[SceneObject],
    *,
    stamp_ns: int,
) -> None:
    """Write a map with its objects, whole or not at all; the same map gives the same bytes.

    Topics, in the frame "world": `/map/surface` (PointCloud2, see `point_cloud`) in the map's
    own colours, `/map/objects` (MarkerArray: a box and a name each), and `/map/object_outlines`
    (PointCloud2), the boxes' edges as points. Names by label are attached, as in a log.

    Args:
        path: the file, replaced if it is there.
        mesh: the surface, of which the vertices are taken.
        labels: of the vertices.
        objects: numbered from 1 in their order.
        stamp_ns: time of all messages: that of the run's last frame, say.
    """
    seen = mesh.vertices_m, mesh.colors, labels.labels, labels.scores
    messages = {
        SURFACE: point_cloud(*seen, stamp_ns, WORLD_FRAME),
        OUTLINES: _outlines(labels, objects, stamp_ns),
        OBJECTS: _markers(labels, objects, stamp_ns),
    }
    names = {str(number): name for number, name in enumerate(labels.names)}
    with written_whole(path) as temporary, temporary.open("wb") as stream:
        writer = start_mcap(stream)
        content = json.dumps(names).encode()
        writer.add_attachment(0, 0, LABEL_NAMES_ATTACHMENT, "application/json", content)
        schemas = {
            kind: writer.register_schema(kind, SchemaEncoding.ROS2, definition.encode())
            for kind, definition in DEFINITIONS.items()
        }
        # What does not change is told once: players hand it to those who listen later.
        latched = {"offered_qos_profiles": "- durability: transient_local"}
        for topic, message in messages.items():
            kind = _TYPES[topic]
            channel = writer.register_channel(topic, MessageEncoding.CDR, schemas[kind], latched)
            writer.add_message(channel, stamp_ns, encoder(kind)(message), stamp_ns)
        writer.finish()


def _markers(labels: SurfaceLabels, objects: Sequence[SceneObject], stamp_ns: int) -> object:
    """All boxes, with names such as "2 chair"."""
    markers: list[object] = []
    for number, thing in enumerate(objects, start=1):
        r, g, b = labels.palette[labels.labels[thing.vertices[0]]].tolist()
        title = f"{number} {thing.label}"
        markers += box_markers(number, thing.box, title, (r, g, b), stamp_ns, WORLD_FRAME)
    return SimpleNamespace(markers=markers)


def _outlines(labels: SurfaceLabels, objects: Sequence[SceneObject], stamp_ns: int) -> object:
    """The edges of all boxes as points, in the colours of their labels."""
    points, lengths = [np.zeros((0, 3))], []
    for thing in objects:
        edges = [_line(*thing.box.corners_m[[a, b]]) for a, b in _EDGES]
        points += edges
        lengths.append(sum(map(len, edges)))
    first = np.array([thing.vertices[0] for thing in objects], int)
    labels_of = np.repeat(labels.labels[first], lengths)
    scores_of = np.repeat(labels.scores[first], lengths)
    return point_cloud(
        *(np.concatenate(points), labels.palette[labels_of], labels_of, scores_of),
        stamp_ns,
        WORLD_FRAME,
    )


def _line(start_m: np.ndarray, end_m: np.ndarray) -> np.ndarray:
    """Points [N, 3] from one place to another, both included."""
    count = int(np.ceil(np.linalg.norm(end_m - start_m) / OUTLINE_STEP_M)) + 1
    return np.linspace(start_m, end_m, max(count, 2))
