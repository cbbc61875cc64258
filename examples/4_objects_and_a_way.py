"""List the objects of the map as a table, and find a way across its floor.

python examples/4_objects_and_a_way.py ROOM
"""

import csv
import sys
from pathlib import Path

import numpy as np

import proground_log as pg

folder = Path(sys.argv[1])
run = pg.open_run(folder / "run")

with (folder / "objects.csv").open("w", newline="") as stream:
    table = csv.writer(stream)
    table.writerow(["object", "x_m", "y_m", "z_m", "length_m", "width_m", "height_m", "views"])
    for thing in run.objects():
        numbers = [*thing.position_m, *thing.box.extent_m]
        table.writerow([thing.label, *(f"{number:.2f}" for number in numbers), thing.views])
print((folder / "objects.csv").read_text())

path_m = np.array([frame.world_from_camera[:2, 3] for frame in run.log.frames()])
try:
    journey = run.navigate(tuple(path_m[0]), tuple(path_m[len(path_m) // 2]))
    corners_m, clearance_m = journey.route.corners_m, journey.route.clearance_m
    print(f"a way of {len(corners_m)} corners, {clearance_m.min():.2f} m from all that stands")
except pg.ProgroundError as error:
    print(f"no way: {error}")
