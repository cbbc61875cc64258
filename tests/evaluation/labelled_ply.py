"""What tests of label lists share."""

from __future__ import annotations

import numpy as np

RECORD = [("x", "f4"), ("label", "i2"), ("y", "f8"), ("z", "f4"), ("instance", "u1")]


ROWS = [(1.5, 3, -2.25, 0.125, 9), (0.5, -1, 4.75, 8.0, 255), (-7.0, 300, 0.0, 1.0, 0)]


KINDS = {"f4": "float", "f8": "double", "i2": "int16", "u1": "uchar"}


def ply(order: str = "binary_little_endian", newline: str = "\n", faces: bool = True) -> bytes:
    lines = ["ply", f"format {order} 1.0", "comment made up", f"element vertex {len(ROWS)}"]
    lines += [f"property {KINDS[kind]} {name}" for name, kind in RECORD]
    lines += ["element face 1", "property list uchar int vertex_indices"] * faces
    header = "".join(line + newline for line in [*lines, "end_header"]).encode()
    if order == "ascii":
        rows = "".join(" ".join(map(str, row)) + newline for row in ROWS)
        return header + rows.encode() + b"3 0 1 2\n" * faces
    sign = "<" if "little" in order else ">"
    rows = np.array(ROWS, [(name, sign + kind) for name, kind in RECORD])
    return header + rows.tobytes() + bytes([3, *np.arange(3, dtype=sign + "i4").tobytes()]) * faces
