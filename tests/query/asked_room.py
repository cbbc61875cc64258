"""What tests of ask share."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

from proground_log.field.config import FieldConfig
from proground_log.mapping.neural.config import (
    BufferConfig,
    NeuralConfig,
    SamplingConfig,
    SemanticsConfig,
)
from proground_log.perception.task import Task
from proground_log.run.folder import RunFolder
from proground_log.run.manifest import Manifest
from proground_log.run.settings import ReplayConfig, TelemetryConfig

TASK = Task("living", ("sofa", "bed", "table", "chair", "cabinet"), ("rug", "picture"))


CONFIG = ReplayConfig(
    steps=15,
    mapper=NeuralConfig(
        field=FieldConfig(log2_rows=14, levels=8, voxel_m=0.05),
        sampling=SamplingConfig(rays=256, uniform=12, near_surface=7),
        semantics=SemanticsConfig(rays=96, background_rays=48, samples=5),
        buffer=BufferConfig(capacity=60_000, keyframe_samples=5000),
    ),
    telemetry=TelemetryConfig(enabled=False),
)


def without_log(run: Path, folder: Path) -> Path:
    """A copy of a run whose log has gone."""
    shutil.copytree(run, folder / "run")
    manifest = Manifest.read(RunFolder(run).manifest)
    replace(manifest, log_path="/nowhere.mcap").write(RunFolder(folder / "run").manifest)
    return folder / "run"
