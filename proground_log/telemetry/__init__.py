"""Recordings for the rerun viewer: of replays, logs, objects, answers and ways."""
