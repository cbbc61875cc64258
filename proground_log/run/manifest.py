"""The manifest: what made a run."""

from __future__ import annotations

import dataclasses
import json
import platform
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import torch

from proground_log.errors import ProgroundError
from proground_log.files import file_sha256, require_file, written_whole
from proground_log.locations import located
from proground_log.log.reader import LogReader
from proground_log.perception.description import PerceptionDescription, fingerprint
from proground_log.run.cost_model import CostModel
from proground_log.run.settings import ReplayConfig, from_dict
from proground_log.version import __version__

MANIFEST_VERSION = 2
PACKAGES = (
    "mcap",
    "numba",
    "numpy",
    "onnxruntime",
    "opencv-python-headless",
    "scipy",
    "torch",
)
"""Packages whose version can reach a result."""


@dataclass(frozen=True)
class Manifest:
    """What made a run, and what came of it.

    Args:
        log_path: where the log was.
        log_sha256: its bytes' fingerprint.
        config: the settings.
        cost_model: what stages take in simulated time, scaled.
        code_version: of proground-log.
        packages: versions of those that can reach a result.
        machine: processor, its capability as torch sees it, and device.
        threads: threads computed on; does not reach a result.
        perception_sha256: fingerprint of task, texts and heads; None without perception.
        result: the summary, once the run is complete.
    """

    log_path: str
    log_sha256: str
    config: ReplayConfig
    cost_model: CostModel
    code_version: str
    packages: dict[str, str]
    machine: dict[str, str]
    threads: int
    perception_sha256: str | None
    result: dict[str, object] | None = None

    @classmethod
    def of(
        cls,
        log_path: Path,
        config: ReplayConfig,
        cost_model: CostModel,
        device: str,
        perception: PerceptionDescription | None,
    ) -> Manifest:
        """The manifest of a run that is about to start on this machine."""
        return cls(
            log_path=str(log_path.resolve()),
            log_sha256=file_sha256(log_path),
            config=config,
            cost_model=cost_model,
            code_version=__version__,
            packages={name: version(name) for name in PACKAGES},
            machine={
                "processor": platform.machine(),
                "capability": torch.backends.cpu.get_cpu_capability(),
                "device": torch.cuda.get_device_name() if device == "cuda" else "cpu",
            },
            threads=torch.get_num_threads(),
            perception_sha256=fingerprint(perception),
        )

    def write(self, path: Path) -> None:
        """Write it as JSON, whole or not at all."""
        content = {
            "manifest_version": MANIFEST_VERSION,
            **dataclasses.asdict(self),
            "cost_model": self.cost_model.to_json(),
        }
        with written_whole(path) as temporary:
            temporary.write_text(json.dumps(content, indent=2) + "\n")

    @classmethod
    def read(cls, path: Path) -> Manifest:
        """Read it back; raises a ProgroundError where it cannot be."""
        require_file(path)
        try:
            content = json.loads(path.read_text())
            found = content.pop("manifest_version")
            if found != MANIFEST_VERSION:
                raise ProgroundError(
                    f"has manifest version {found}, this pglog reads {MANIFEST_VERSION}",
                    where=path,
                    todo="run the replay again with this version of pglog",
                )
            made_of = {
                "config": from_dict(ReplayConfig, content["config"]),
                "cost_model": CostModel.from_json(content["cost_model"], where=path),
            }
            return cls(**{**content, **made_of})
        except (ValueError, KeyError, TypeError) as error:
            raise ProgroundError(
                f"cannot be read as a manifest ({error!r})", where=path, todo="run the replay again"
            ) from error


def open_log_of(manifest: Manifest, log_path: Path | None) -> LogReader:
    """The log that a run was made of: where the run found it, or where it has moved to.

    Raises:
        ProgroundError: it is not there, or another log.
    """
    path = log_path or located(manifest.log_path)
    if not path.is_file():
        raise ProgroundError(
            "the log that the run was made of is not there",
            where=path,
            todo="say with --log where it is now",
        )
    reader = LogReader(path)
    if file_sha256(reader.path) != manifest.log_sha256:
        raise ProgroundError(
            "is not the log that the run was made of",
            where=reader.path,
            todo="give it with --log" if log_path is None else "check the path",
        )
    return reader
