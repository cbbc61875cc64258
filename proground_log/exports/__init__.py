"""A map in the files of other tools: a file a format."""
