"""PGM and YAML: the floor as an occupancy grid of ROS map_server (wiki.ros.org/map_server)."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from PIL import Image

from proground_log.files import written_whole
from proground_log.navigation.floor_plan import FREE, OCCUPIED, UNKNOWN, FloorPlan

PIXELS = {UNKNOWN: 205, FREE: 254, OCCUPIED: 0}
"""By state of a cell: what map_saver writes. A pixel p means an occupancy of (255 - p) / 255."""
OCCUPIED_FROM, FREE_BELOW = 0.65, 0.196
"""map_server's own thresholds: 205 gives 0.19608, which is not below the second."""
SUFFIX = ".yaml"


def image_of(path: Path) -> Path:
    """The image (.pgm) that goes with a grid's YAML file: beside it, of the same name."""
    return path.with_suffix(".pgm")


def write_occupancy(path: Path, plan: FloorPlan) -> None:
    """Write a floor plan as YAML and PGM, each whole or not at all.

    ROS wants z up: the grid lies in axes of its own, x and y along the floor, z = 0 on it. The
    YAML's comment says how to get there from the world, as a 4x4 matrix, by rows.

    Args:
        path: the YAML file, replaced if it is there; the image goes beside it.
        plan: the floor.
    """
    pixels = np.array([PIXELS[state] for state in range(len(PIXELS))], np.uint8)[plan.cells]
    # The image's rows run from the largest y to the smallest.
    with written_whole(image_of(path)) as temporary, temporary.open("wb") as stream:
        Image.fromarray(np.ascontiguousarray(pixels.T[::-1])).save(stream, format="PPM")
    grid_from_world = np.eye(4)
    grid_from_world[:3, :3] = plan.ground.plan_from_world
    grid_from_world[2, 3] = -plan.ground.floor_m
    x_m, y_m = (round(float(value), 6) + 0.0 for value in plan.origin_m)
    lines = [
        "# grid_from_world: " + json.dumps((grid_from_world.round(6) + 0.0).tolist()),
        # Quoted as in JSON, which YAML contains, whatever the name has in it.
        f"image: {json.dumps(image_of(path).name)}",
        "mode: trinary",
        f"resolution: {plan.cell_m}",
        f"origin: [{x_m}, {y_m}, 0.0]",
        "negate: 0",
        f"occupied_thresh: {OCCUPIED_FROM}",
        f"free_thresh: {FREE_BELOW}",
    ]
    with written_whole(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", "utf-8")
