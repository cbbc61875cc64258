"""A file a format: each has a Source, and says whether it recognises a path."""
