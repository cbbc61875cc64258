"""What the LiDAR formats of Apple's devices share: one view for colour and depth, confidence."""

from __future__ import annotations

from typing import Literal, get_args

from proground_log.camera import Calibration, Camera
from proground_log.errors import ProgroundError

Confidence = Literal[0, 1, 2]
"""ARKit's: 0 low, 1 medium, 2 high."""
MOST_CONFIDENCE = max(get_args(Confidence))


def phone_calibration(color: Camera, depth_size: tuple[int, int], *, where: object) -> Calibration:
    """The rig of a phone: ARKit gives depth in the colour camera's view, in fewer pixels.

    Args:
        color: the colour camera.
        depth_size: width and height of the depth image in pixels.
        where: the file, for messages.

    Raises:
        ProgroundError: the two images have not the same shape, so that they cannot be one view.
    """
    depth = color.scaled_to_width(depth_size[0])
    if (depth.width, depth.height) != depth_size:
        raise ProgroundError(
            f"depth of {depth_size[0]}x{depth_size[1]} has not the shape of the colour image, "
            f"{color.width}x{color.height}",
            where=where,
            todo="pass the calibration, or bring the images of one recording together",
        )
    registered = Calibration.registered(color)
    return Calibration(color, depth, registered.depth_from_color)


def require_confidence(minimum: int) -> int:
    """Return the least confidence that is asked for; raise a ProgroundError unless ARKit has it."""
    if not 0 <= minimum <= MOST_CONFIDENCE:
        raise ProgroundError(
            f"there is no confidence of {minimum}",
            where="min_confidence",
            todo="choose 0 (keep all depth), 1 or 2 (only the best)",
        )
    return minimum


def low_confidence_note(minimum: int) -> dict[str, str]:
    """The note on depth that is left out."""
    return {"depth left out": f"of a confidence below {minimum}"} if minimum else {}
