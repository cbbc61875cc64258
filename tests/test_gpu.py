"""What holds on a GPU, on a machine that has one (`make test-gpu`); skipped elsewhere."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from proground_log.run.folder import RunFolder
from proground_log.run.ledger import read_ledger
from proground_log.run.settings import TelemetryConfig
from replay.session import replay
from tests.replay.golden import SMALL

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="torch sees no CUDA device")


def test_a_replay_on_a_gpu_gives_the_same_ledger_twice(room_log: Path, tmp_path: Path) -> None:
    config = replace(SMALL, device="cuda", telemetry=TelemetryConfig(enabled=False))
    manifests = [replay(room_log, tmp_path / name, config) for name in ("a", "b")]
    ledgers = [list(read_ledger(RunFolder(tmp_path / name).ledger)) for name in ("a", "b")]
    assert manifests[0].machine["device"] != "cpu"
    assert ledgers[0] == ledgers[1]
