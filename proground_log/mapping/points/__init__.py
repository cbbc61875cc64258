"""What maps of points need: means by voxel, points drawn into a view, a map of them."""
