"""Hostile input: files that are nearly right, read until something gives that should not.

A reader may give a result or a ProgroundError, and nothing else: no other exception, no crash, no
hang, no memory out of proportion to the file, no file written. `make fuzz`, or
`python -m tests.fuzz TARGET --seconds 60`; the test suite runs a few inputs of each target.
"""
