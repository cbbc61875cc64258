"""The voxels of the surfaces that are made of a map, unless others are asked for."""

LOOK_VOXEL_M = 0.02
"""Of a surface to be looked at, and to be compared with a true one."""
OBJECTS_VOXEL_M = 0.03
"""Of the surface whose objects are listed, asked and judged: a cup has some fifty vertices."""
