"""A run made again from its manifest: equal to the bit, and stopped where it is not."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from pglog.commands import main
from proground_log.errors import ProgroundError
from proground_log.evaluation.judge import evaluate_run
from proground_log.events import Event, FrameDone
from proground_log.query.surface import Surfaces
from proground_log.run.folder import Checkpoint, RunFolder
from proground_log.run.ledger import read_ledger
from proground_log.run.manifest import Manifest
from proground_log.run.opened import OpenedRun
from proground_log.run.settings import SimulationConfig
from replay.digests import state_digests
from replay.divergence.rerun import Excerpt, rerun, state_after
from replay.session import replay
from tests.replay.divergence.ledger_edits import Entry, edited_run
from tests.replay.golden import COST, SMALL, perceiver_of
from tests.replay.small_replay import ledger_bytes

pytestmark = pytest.mark.slow

TINY = replace(
    SMALL,
    steps=2,
    max_frames=6,
    checkpoint_every=2,
    keep_checkpoints=True,
    simulation=SimulationConfig(cost=COST, rate=2.0, cost_scale=2.0),
    telemetry=replace(SMALL.telemetry, enabled=False),
)
"""Under a schedule that drops frame 2; frame 4 is held out."""


@pytest.fixture(scope="module")
def run(room_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rerun") / "run"
    replay(room_log, path, TINY)
    return path


@pytest.fixture(scope="module")
def closely(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("closely") / "run"
    rerun(run, path, excerpt=Excerpt(keep_every=1))
    return path


class CountFrames:
    def __init__(self) -> None:
        self.frames = 0

    def on_event(self, event: Event) -> None:
        self.frames += isinstance(event, FrameDone)

    def close(self) -> None:
        pass


@pytest.mark.parametrize("by", ["folder", "manifest"])
def test_again_is_the_same(run: Path, tmp_path: Path, by: str) -> None:
    path = run if by == "folder" else RunFolder(run).manifest
    assert rerun(path, tmp_path / "again", check=True) is None
    assert ledger_bytes(tmp_path / "again") == ledger_bytes(run)
    manifests = [Manifest.read(RunFolder(p).manifest) for p in (run, tmp_path / "again")]
    assert manifests[0].cost_model == manifests[1].cost_model


def test_a_check_stops_at_the_first_difference(run: Path, tmp_path: Path) -> None:
    def change(entries: list[Entry]) -> list[Entry]:
        step = [entry for entry in entries if entry["event"] == "step"][3]
        step["draws"] = "0" * 64
        return entries

    other = edited_run(run, tmp_path / "other", change)
    counter = CountFrames()
    divergence = rerun(other, tmp_path / "again", check=True, watchers=lambda _: [counter])
    assert divergence is not None
    assert (divergence.step, divergence.cause) == (3, "random draw")
    assert counter.frames == 1
    assert not RunFolder(tmp_path / "again").is_finished
    assert rerun(other, tmp_path / "unchecked") is None


@pytest.mark.parametrize(
    ("edit", "whose"), [(lambda e: e[:-9], "first"), (lambda e: [*e, e[-2]], "second")]
)
def test_a_check_tells_where_one_ends(
    run: Path, tmp_path: Path, edit: Callable[[list[Entry]], list[Entry]], whose: str
) -> None:
    other = edited_run(run, tmp_path / "other", edit)
    divergence = rerun(other, tmp_path / "again", check=True)
    assert divergence is not None
    assert f"{whose}: the run ends here" in divergence.details


def test_a_log_that_is_gone_or_changed_is_named(run: Path, room_log: Path, tmp_path: Path) -> None:
    copy = tmp_path / "run"
    shutil.copytree(run, copy)
    manifest = json.loads(RunFolder(copy).manifest.read_text())
    gone = tmp_path / "gone.mcap"
    RunFolder(copy).manifest.write_text(json.dumps({**manifest, "log_path": str(gone)}))
    with pytest.raises(ProgroundError, match=r"gone\.mcap: .*is not there; .*--log"):
        rerun(copy, tmp_path / "again", check=True)
    with pytest.raises(ProgroundError, match=r"gone\.mcap: .*is not there; .*--log"):
        evaluate_run(Surfaces(OpenedRun.finished(copy)), 0.1)
    with pytest.raises(ProgroundError, match=r"lost\.mcap: .*is not there; .*--log"):
        OpenedRun.finished(copy, tmp_path / "lost.mcap")
    changed = shutil.copy(room_log, tmp_path / "changed.mcap")
    assert rerun(copy, tmp_path / "again", check=True, log=changed) is None
    RunFolder(copy).manifest.write_text(json.dumps({**manifest, "log_sha256": "0"}))
    with pytest.raises(ProgroundError, match="is not the log that the run was made of"):
        rerun(copy, tmp_path / "third")
    assert not (tmp_path / "third").exists()


def test_what_cannot_be_is_refused_before_any_work(run: Path, tmp_path: Path) -> None:
    with pytest.raises(ProgroundError, match="is the run itself"):
        rerun(run, run, overwrite=True)
    with pytest.raises(ProgroundError, match="no such file"):
        rerun(tmp_path / "nothing", tmp_path / "again")
    start = RunFolder(run).kept_checkpoints()[2]
    with pytest.raises(ProgroundError, match="begins at the beginning"):
        rerun(run, tmp_path / "again", check=True, excerpt=Excerpt(start))
    with pytest.raises(ProgroundError, match="keep-every"):
        rerun(run, tmp_path / "again", excerpt=Excerpt(keep_every=0))
    assert ledger_bytes(run)
    assert not (tmp_path / "again").exists()


def test_perception_must_be_the_runs(room_log: Path, run: Path, tmp_path: Path) -> None:
    perceiver = perceiver_of(room_log)
    config = replace(TINY, max_frames=2, steps=1, simulation=SimulationConfig(cost=COST))
    replay(room_log, tmp_path / "run", config, perceiver=perceiver)
    with pytest.raises(ProgroundError, match="the perception is not"):
        rerun(tmp_path / "run", tmp_path / "again", check=True)
    with pytest.raises(ProgroundError, match="the perception is not"):
        rerun(run, tmp_path / "again", perceiver=perceiver)
    assert rerun(tmp_path / "run", tmp_path / "again", check=True, perceiver=perceiver) is None


def test_a_part_from_a_checkpoint_looked_at_closely(run: Path, tmp_path: Path) -> None:
    start = RunFolder(run).kept_checkpoints()[2]
    whole = [e for e in read_ledger(RunFolder(run).ledger) if e["event"] == "step"]
    rerun(run, tmp_path / "part", excerpt=Excerpt(start, until_frame=3, keep_every=1))
    entries = list(read_ledger(RunFolder(tmp_path / "part").partial_ledger))
    steps = [entry for entry in entries if entry["event"] == "step"]
    assert steps == whole[: len(steps)]
    assert steps[-1]["frame"] == 3
    states = [entry["step"] for entry in entries if entry["event"] == "state"]
    assert states[-3:] == [len(steps) - 2, len(steps) - 1, len(steps)]


@pytest.mark.parametrize("from_start", [False, True])
def test_the_state_in_the_middle_of_a_frame(
    run: Path, closely: Path, tmp_path: Path, from_start: bool
) -> None:
    """Under a schedule, and for the last frame too; compared with the digest of that step."""
    entries = list(read_ledger(RunFolder(closely).ledger))
    digests = {entry["step"]: entry["digests"] for entry in entries if entry["event"] == "state"}
    last = max(entry["frame"] for entry in entries if entry["event"] == "step")
    step = next(e for e in entries if e["event"] == "step" and e["frame"] == last)
    assert step["iteration"] == 0
    start = None if from_start else RunFolder(run).kept_checkpoints()[2]
    output = tmp_path / "state.safetensors"
    state_after(run, output, frame=last, iteration=0, start=start)
    assert state_digests(Checkpoint.read(output).state) == digests[step["step"] + 1]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["state.safetensors"]


def test_the_command(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def pglog(*arguments: object) -> int:
        monkeypatch.setattr(sys, "argv", ["pglog", *(str(argument) for argument in arguments)])
        with pytest.raises(SystemExit) as stop:
            main()
        assert isinstance(stop.value.code, int)
        return stop.value.code

    assert pglog("rerun", run, "-o", tmp_path / "same", "--check") == 0
    assert "repeats itself, bit for bit" in capsys.readouterr().out

    def change(entries: list[Entry]) -> list[Entry]:
        entries[0]["input"] = "0" * 64
        return entries

    other = edited_run(run, tmp_path / "other", change)
    assert pglog("rerun", other, "-o", tmp_path / "again", "--check") == 1
    shown = capsys.readouterr().out
    assert "first difference: input, at frame 0" in shown
    assert "nothing that made the runs differs" in shown
    assert pglog("rerun", run, "-o", tmp_path / "x", "--until-step", 1) == 2
    assert "--until-frame" in capsys.readouterr().err
