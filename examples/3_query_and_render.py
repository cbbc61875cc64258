"""Ask the map where something is, and render it as seen from a frame's place.

python examples/3_query_and_render.py ROOM [TEXT]
"""

import sys
from pathlib import Path

from PIL import Image

import proground_log as pg

folder = Path(sys.argv[1])
text = sys.argv[2] if len(sys.argv) > 2 else "sofa"
run = pg.open_run(folder / "run")

answer = run.query(text)
print(f"{text}: {len(answer.things)} found, the best {answer.measure.name} is {answer.best:.2f}")
for thing in answer.things:
    at, size = thing.position_m.round(2), thing.box.extent_m.round(2)
    print(f"  {thing.label} at {at} m, {size} m, {thing.score:.2f}")

(frame,) = run.log.frames([0])
camera = run.log.calibration.depth.pinhole().scaled_to_width(160)
view = run.render(frame.world_from_camera, camera)
Image.fromarray(view.color).save(folder / "view.png")
print(f"view.png: {camera.width} x {camera.height}, up to {view.depth_m.max():.2f} m away")
