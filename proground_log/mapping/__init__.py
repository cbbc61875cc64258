"""Mappers and maps: the socket that all of them fit, and those that are built in."""
