"""The contract of replay where meaning is learnt: the same ledger, however it comes about."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from proground_log.errors import ProgroundError
from proground_log.evaluation.judge import evaluate_run
from proground_log.log.reader import LogReader
from proground_log.mapping.map_file import load_map
from proground_log.perception.builtin_texts import BuiltinTexts
from proground_log.perception.perceive import perceive
from proground_log.query.surface import Surfaces
from proground_log.run.folder import RunFolder
from proground_log.run.ledger import read_ledger
from proground_log.run.opened import OpenedRun
from proground_log.run.settings import ReplayConfig
from replay.ablation.variants import Variant, run_variants, weighting_and_filtering
from replay.session import ReplayStoppedError, replay
from tests.replay.golden import SMALL, perceiver_of
from tests.replay.small_replay import StopAfter, ledger_bytes, replay_with_threads

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def seen_log(room_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The room with regions in its log."""
    path = tmp_path_factory.mktemp("seen") / "seen.mcap"
    perceive(room_log, perceiver_of(room_log), path, overwrite=False, progress=lambda *_: None)
    return path


@pytest.fixture(scope="module")
def seen_run(seen_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = tmp_path_factory.mktemp("reference") / "run"
    replay(seen_log, run, SMALL)
    return run


def test_perceiving_during_the_replay_gives_the_same_ledger(
    room_log: Path, seen_run: Path, tmp_path: Path
) -> None:
    replay(room_log, tmp_path / "run", SMALL, perceiver=perceiver_of(room_log))
    assert ledger_bytes(tmp_path / "run") == ledger_bytes(seen_run)
    maps = [RunFolder(run).map.read_bytes() for run in (seen_run, tmp_path / "run")]
    assert maps[0] == maps[1]


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_any_number_of_threads_gives_the_same_ledger(
    seen_log: Path, seen_run: Path, tmp_path: Path, threads: int
) -> None:
    replay_with_threads(seen_log, tmp_path / "run", threads)
    assert ledger_bytes(tmp_path / "run") == ledger_bytes(seen_run)


def test_stopped_and_resumed_gives_the_same_ledger(
    room_log: Path, seen_run: Path, tmp_path: Path
) -> None:
    run, perceiver = tmp_path / "run", perceiver_of(room_log)
    with pytest.raises(ReplayStoppedError):
        replay(room_log, run, SMALL, perceiver=perceiver, watchers=lambda _: [StopAfter(5)])
    with pytest.raises(ProgroundError, match="the perception is not"):
        replay(room_log, run, ReplayConfig(), resume=True)
    replay(room_log, run, ReplayConfig(), resume=True, perceiver=perceiver)
    assert ledger_bytes(run) == ledger_bytes(seen_run)


def test_semantics_leave_geometry_and_colour_as_they_are(
    room_log: Path, seen_run: Path, tmp_path: Path
) -> None:
    replay(room_log, tmp_path / "run", SMALL)
    geometry = ("field", "averaged", "optimiser", "buffer", "observed", "steps")
    states = []
    for run in (seen_run, tmp_path / "run"):
        entries = [e for e in read_ledger(RunFolder(run).ledger) if e["event"] == "state"]
        assert len(entries) == 8
        states.append(
            [{k: v for k, v in e["digests"].items() if k.startswith(geometry)} for e in entries]
        )
    assert states[0] == states[1]
    steps = [e for e in read_ledger(RunFolder(seen_run).ledger) if e["event"] == "step"]
    assert {"semantic", "scale", "uncertainty"} <= set(steps[-1]["losses"])


def test_another_task_is_another_ledger(room_log: Path, seen_run: Path, tmp_path: Path) -> None:
    fewer = perceiver_of(room_log, cushions=False)
    replay(room_log, tmp_path / "run", SMALL, perceiver=fewer)
    assert ledger_bytes(tmp_path / "run") != ledger_bytes(seen_run)
    description = load_map(RunFolder(tmp_path / "run").map).description
    assert description is not None
    assert description.task == fewer.description.task


def test_a_variant_of_an_ablation_is_a_replay_of_its_own(seen_run: Path, room_log: Path) -> None:
    perceiver, config = perceiver_of(room_log), replace(SMALL, hold_out_every=0)
    run = seen_run.parent / "all"
    replay(room_log, run, config, perceiver=perceiver)
    expected = evaluate_run(Surfaces(OpenedRun.finished(run)), 0.1).scores
    own = Variant("own", config.mapper.semantics)
    variants = [*weighting_and_filtering(config.mapper.semantics), own]
    outcomes = run_variants(
        LogReader(room_log), variants, lambda _: perceiver, BuiltinTexts(), config, lambda *_: None
    )
    steps = [e for e in read_ledger(RunFolder(run).ledger) if e["event"] == "step"]
    assert len(outcomes["own"].semantic_losses) == len(steps)
    assert outcomes["own"].semantic_losses == outcomes["both"].semantic_losses
    assert outcomes["own"].semantic_losses != outcomes["neither"].semantic_losses
    # The map on disk is rounded.
    assert outcomes["own"].scores.micro[1] == pytest.approx(expected["top1_percent"], abs=2.0)
