"""Colours that telemetry gives to what has none of its own."""

CURVE_COLORS = (
    (86, 180, 233),
    (230, 159, 0),
    (0, 190, 135),
    (240, 228, 66),
    (213, 94, 0),
    (204, 121, 167),
    (110, 130, 255),
)
"""Okabe and Ito's palette, told apart by people with colour-blindness too, fit for black."""
TOTAL_COLOR = (255, 255, 255)
NOTHING_COLOR = (84, 87, 94)
"""Background, and what is without supervision."""
