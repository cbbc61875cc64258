"""The manifest: what made a run."""

from __future__ import annotations

import dataclasses
import json
import platform
from collections.abc import Collection
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import torch

from proground_log.errors import ProgroundError
from proground_log.files import file_sha256, require_file, written_whole
from proground_log.perception.description import PerceptionDescription, fingerprint
from proground_log.run.cost_model import CostModel
from proground_log.run.settings import ReplayConfig, config_from_dict, walk
from proground_log.version import __version__

MANIFEST_VERSION = 3
BEFORE_KINDS = 2
"""Version of the manifests of 0.1.0, which knew one kind of mapper."""
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
        version: of the manifest, as it was read.
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
    version: int = MANIFEST_VERSION

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
            "manifest_version": self.version,
            **dataclasses.asdict(self),
            "cost_model": self.cost_model.to_json(),
        }
        del content["version"]
        with written_whole(path) as temporary:
            temporary.write_text(json.dumps(content, indent=2) + "\n")

    @classmethod
    def read(cls, path: Path) -> Manifest:
        """Read it back; raises a ProgroundError where it cannot be."""
        require_file(path)
        try:
            content = json.loads(path.read_text())
            found = content.pop("manifest_version")
            if found not in (MANIFEST_VERSION, BEFORE_KINDS):
                raise ProgroundError(
                    f"has manifest version {found}, this pglog reads {MANIFEST_VERSION}",
                    where=path,
                    todo="run the replay again with this version of pglog",
                )
            made_of = {
                "config": config_from_dict(content["config"]),
                "cost_model": CostModel.from_json(content["cost_model"], where=path),
                "version": found,
            }
            return cls(**{**content, **made_of})
        except (ValueError, KeyError, TypeError) as error:
            raise ProgroundError(
                f"cannot be read as a manifest ({error!r})", where=path, todo="run the replay again"
            ) from error

    def require_repeatable(self, where: object) -> None:
        """Raise a ProgroundError unless this version of pglog makes what the manifest says."""
        if self.version != MANIFEST_VERSION:
            raise ProgroundError(
                f"was made by pglog {self.code_version}, and can be read but not gone on with",
                where=where,
                todo=f"use pglog {self.code_version} for that, or replay its log again",
            )

    def differences(self, other: Manifest, *, but: Collection[str] = ()) -> list[str]:
        """What made another run that did not make this one, in words; nothing of it: the same map.

        Args:
            other: the other run's.
            but: dotted paths of settings that do not count, or of parts of them.
        """
        parts = {
            "log": (self.log_sha256, other.log_sha256),
            "settings": (_counted(self.config, but), _counted(other.config, but)),
            "cost model": (self.cost_model, other.cost_model),
            "perception": (self.perception_sha256, other.perception_sha256),
        }
        return [name for name, (ours, theirs) in parts.items() if ours != theirs]


def _counted(config: ReplayConfig, but: Collection[str]) -> dict[str, object]:
    return {
        path: value
        for path, _, value in walk(config)
        if not any(path == left_out or path.startswith(f"{left_out}.") for left_out in but)
    }
