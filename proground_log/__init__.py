"""proground-log: log-driven, offline-replayable online neural implicit mapping."""

__version__ = "0.1.0"
