"""A run, opened: what its files say, each read once, when it is first needed."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

from proground_log.errors import ProgroundError
from proground_log.files import file_sha256
from proground_log.locations import located
from proground_log.log.reader import LogReader
from proground_log.mapping.map import Map
from proground_log.mapping.map_file import load_map
from proground_log.run.folder import RunFolder
from proground_log.run.history import History, read_history
from proground_log.run.ledger import read_ledger
from proground_log.run.manifest import Manifest


class OpenedRun:
    """A run on disk.

    Args:
        path: its folder, or its manifest.json.
        log_path: its log, where it has moved; None where it is where the run found it.
    """

    def __init__(self, path: Path, log_path: Path | None = None) -> None:
        is_manifest = path.name == "manifest.json" and not path.is_dir()
        self.folder = RunFolder(path.parent if is_manifest else path)
        self._log_path = log_path

    @classmethod
    def finished(cls, path: Path, log_path: Path | None = None) -> OpenedRun:
        """Open a run; raise a ProgroundError unless it came to its end and a named log is there."""
        opened = cls(path, log_path)
        opened.folder.require_finished()
        if log_path is not None:
            opened._require_log(log_path)
        return opened

    @property
    def path(self) -> Path:
        """Its folder."""
        return self.folder.path

    @cached_property
    def manifest(self) -> Manifest:
        """What made it."""
        return Manifest.read(self.folder.manifest)

    @cached_property
    def log(self) -> LogReader:
        """The log that it was made of.

        Raises:
            ProgroundError: it is not there, or another log.
        """
        path = self._log_path or located(self.manifest.log_path)
        self._require_log(path)
        reader = LogReader(path)
        if file_sha256(reader.path) != self.manifest.log_sha256:
            raise ProgroundError(
                "is not the log that the run was made of",
                where=reader.path,
                todo="give it with --log" if self._log_path is None else "check the path",
            )
        return reader

    @staticmethod
    def _require_log(path: Path) -> None:
        if not path.is_file():
            raise ProgroundError(
                "the log that the run was made of is not there",
                where=path,
                todo="say with --log where it is now",
            )

    @cached_property
    def log_if_there(self) -> LogReader | None:
        """The log; None where nobody says where it is and it is not where it was.

        Raises:
            ProgroundError: the log that was named is not there, or is another.
        """
        try:
            return self.log
        except ProgroundError:
            if self._log_path is not None:
                raise
            return None

    @cached_property
    def map(self) -> Map:
        """Its map."""
        return load_map(self.folder.map)

    @cached_property
    def map_sha256(self) -> str:
        """Fingerprint of its map, hexadecimal."""
        return file_sha256(self.folder.map)

    @cached_property
    def history(self) -> History:
        """Its ledger as curves."""
        return read_history(self.folder.ledger)

    @cached_property
    def mapped_frames(self) -> list[int]:
        """Numbers of the frames that it learnt from: neither held out nor dropped."""
        entries = read_ledger(self.folder.ledger)
        seen = [entry for entry in entries if entry["event"] in ("frame", "done")]
        held_out = {entry["frame"] for entry in seen if entry.get("held_out")}
        return sorted({entry["frame"] for entry in seen if entry["event"] == "done"} - held_out)

    def require_meaning(self) -> None:
        """Raise a ProgroundError unless its map knows what things are."""
        if self.map.description is None:
            raise ProgroundError(
                "the map knows no meaning, since its log had no regions",
                where=self.path,
                todo="run `pglog perceive` on the log, and replay what it gives",
            )
