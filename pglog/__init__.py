"""The command line: parses, calls, prints. A file a group of commands."""
