"""Logs on disk: messages, writer, reader, registration, and what is wrong with one."""
