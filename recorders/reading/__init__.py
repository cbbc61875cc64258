"""What formats share: images, times, poses, files."""
