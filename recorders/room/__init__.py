"""The built-in furnished room: exact colour, depth, classes and mesh, from a seed."""

from recorders.room.scene import RoomObject
from recorders.room.source import RoomSource

__all__ = ["RoomObject", "RoomSource"]
