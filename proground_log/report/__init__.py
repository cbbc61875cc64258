"""A run as one web page: what a reader wants before opening a viewer."""
