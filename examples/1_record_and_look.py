"""Record the built-in room as a log, and look at what is in it.

python examples/1_record_and_look.py ROOM [FRAMES]
"""

import sys
from pathlib import Path

import proground_log as pg
from proground_log.frame import Selection
from recorders.record import record
from recorders.room import RoomSource

folder = Path(sys.argv[1])
frames = int(sys.argv[2]) if len(sys.argv) > 2 else 120
path = folder / "room.mcap"
source = RoomSource(frames=frames)
record(source, "room", path, Selection(), overwrite=True, progress=lambda *_: None)

log = pg.open_log(path)
camera = log.calibration.depth
print(f"{log.recording.source}: {len(log)} frames of {camera.width} x {camera.height} pixels")
print(f"labels: {', '.join(log.label_names.values())}")
for frame in log.frames([0, len(log) // 2]):
    color, depth_m = frame.decode_color(), frame.depth_m  # uint8 [H, W, 3], float32 [H, W]
    seen = depth_m > 0
    x_m, y_m, z_m = frame.world_from_camera[:3, 3]
    print(f"frame {frame.index}, from {x_m:.2f} {y_m:.2f} {z_m:.2f} m:", end=" ")
    print(f"{depth_m[seen].mean():.2f} m away, mean colour {color[seen].mean(axis=0).round()}")
