"""Two states of settings or code: the first step and the tensors that differ are found."""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from pglog.commands import main
from proground_log.errors import ProgroundError
from proground_log.run.folder import RunFolder
from proground_log.run.ledger import read_ledger
from proground_log.run.settings import ReplayConfig, SimulationConfig
from replay.divergence.bisect import Bisection, bisect, newest_equal_checkpoint
from replay.divergence.rerun import Excerpt, rerun, state_after
from replay.session import replay
from tests.replay.divergence.ledger_edits import Entry, edited_run
from tests.replay.golden import COST, SMALL

pytestmark = pytest.mark.slow

TINY = replace(
    SMALL,
    max_frames=7,
    digest_every=1000,
    checkpoint_every=2,
    keep_checkpoints=True,
    telemetry=replace(SMALL.telemetry, enabled=False),
)
REPOSITORY = Path(__file__).parents[3]


@dataclass(frozen=True)
class Again:
    """A run made again by this code; remembers what was asked of it."""

    run: RunFolder
    asked: list[Excerpt]

    def rerun(self, output: Path, excerpt: Excerpt) -> None:
        self.asked.append(excerpt)
        rerun(self.run.path, output, excerpt=excerpt)

    def state_after(self, output: Path, frame: int, iteration: int, start: Path | None) -> None:
        state_after(self.run.path, output, frame=frame, iteration=iteration, start=start)


def again(run: Path) -> Again:
    return Again(RunFolder(run), [])


def found_in(first: Path, second: Path, output: Path) -> Bisection:
    found = bisect(again(first), again(second), output)
    assert found is not None
    return found


def run_of(log: Path, path: Path, config: ReplayConfig) -> Path:
    replay(log, path, config)
    return path


@pytest.fixture(scope="module")
def run(room_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_of(room_log, tmp_path_factory.mktemp("bisect") / "run", TINY)


def small_buffer(capacity: int) -> ReplayConfig:
    """The buffer is full, and samples have to go, from some keyframe on."""
    buffer = replace(TINY.mapper.buffer, capacity=capacity)
    return replace(TINY, mapper=replace(TINY.mapper, buffer=buffer))


def test_equal_runs_have_nothing_to_find(run: Path, tmp_path: Path) -> None:
    assert bisect(again(run), again(run), tmp_path / "out") is None
    assert not (tmp_path / "out").exists()


def test_a_weight_differs_from_the_first_step_in_what_is_learnt(
    room_log: Path, run: Path, tmp_path: Path
) -> None:
    weights = replace(TINY.mapper.weights, sdf=201.0)
    config = replace(TINY, mapper=replace(TINY.mapper, weights=weights))
    found = found_in(run, run_of(room_log, tmp_path / "other", config), tmp_path / "out")
    assert found.frames_equal == 0
    assert (found.frame, found.iteration, found.step) == (0, 0, 0)
    assert "optimiser/0/exp_avg" in found.tensors
    assert found.tensors["optimiser/0/exp_avg"].distance
    assert not any(name.startswith("buffer/") for name in found.tensors)


def test_a_full_buffer_differs_later_and_the_search_begins_at_a_checkpoint(
    room_log: Path, run: Path, tmp_path: Path
) -> None:
    """With 900 samples a keyframe, every second frame, a cap of 2000 is met at the third: frame 5,
    as frame 4 is held out."""
    other = run_of(room_log, tmp_path / "other", small_buffer(2000))
    entries = list(read_ledger(RunFolder(other).ledger))
    evicting = next(e["frame"] for e in entries if e["event"] == "keyframe" and e["evicted"])
    sides = again(run), again(other)
    found = bisect(*sides, tmp_path / "out")
    assert found is not None
    assert found.divergence.frame == evicting
    assert found.divergence.cause == "buffer"
    assert (found.frame, found.iteration) == (evicting, 0)
    assert 0 < found.frames_equal <= evicting
    for side in sides:
        [excerpt] = side.asked
        assert excerpt.start is not None
        assert excerpt.until_frame == evicting
    assert "buffer/places" in found.tensors


def test_a_difference_before_the_ledger_shows_it_is_found(
    room_log: Path, run: Path, tmp_path: Path
) -> None:
    """The ledgers are made to agree up to a later step; checkpoints tell where they truly part."""
    other = run_of(room_log, tmp_path / "other", small_buffer(2000))
    reference = list(read_ledger(RunFolder(run).ledger))

    def agree(entries: list[Entry]) -> list[Entry]:
        same = next(i for i, e in enumerate(reference) if e["event"] == "done" and e["frame"] == 5)
        return [*reference[: same + 1], *entries[same + 1 :]]

    shown = edited_run(other, tmp_path / "shown", agree)
    found = found_in(run, shown, tmp_path / "out")
    assert found.frame == 5
    assert found.frames_equal <= 5


def test_under_a_budget_the_state_is_that_of_the_step(room_log: Path, tmp_path: Path) -> None:
    simulation = SimulationConfig(cost=COST, budget_ms=60.0, rate=3.0)
    runs = [
        run_of(
            room_log,
            tmp_path / str(cap),
            replace(small_buffer(cap), simulation=simulation, max_frames=10),
        )
        for cap in (1500, 3000)
    ]
    found = found_in(runs[0], runs[1], tmp_path / "out")
    assert found.iteration == 0
    digests = []
    for name in ("first", "second"):
        folder = RunFolder(tmp_path / "out" / name)
        ledger = folder.ledger if folder.ledger.is_file() else folder.partial_ledger
        digests.append({e["step"]: e["digests"] for e in read_ledger(ledger) if "digests" in e})
    assert found.step is not None
    a, b = (of[found.step + 1] for of in digests)
    assert set(found.tensors) == {name for name in a if a[name] != b.get(name)}


def test_runs_that_do_other_work_have_no_step_in_common(
    room_log: Path, run: Path, tmp_path: Path
) -> None:
    other = run_of(room_log, tmp_path / "other", replace(TINY, steps=2))
    found = found_in(run, other, tmp_path / "out")
    assert (found.divergence.cause, found.divergence.frame) == ("schedule", 0)
    assert (found.step, found.tensors) == (None, {})


def test_a_difference_that_does_not_show_again(run: Path, tmp_path: Path) -> None:
    def change(entries: list[Entry]) -> list[Entry]:
        entries[0]["input"] = "0"
        return entries

    with pytest.raises(ProgroundError, match="does not show again"):
        found_in(run, edited_run(run, tmp_path / "other", change), tmp_path / "out")


def test_checkpoints_without_a_counterpart_are_of_no_use(run: Path, tmp_path: Path) -> None:
    shutil.copytree(run, tmp_path / "copy")
    a, b = RunFolder(run), RunFolder(tmp_path / "copy")
    assert newest_equal_checkpoint(a, b, 99)[0] == max(a.kept_checkpoints())
    assert newest_equal_checkpoint(a, b, 3)[0] == 2
    b.kept_checkpoints()[2].unlink()
    assert newest_equal_checkpoint(a, b, 3) == (0, (None, None))


def checkout_with(code: Path, path: str, old: str, new: str) -> Path:
    """A checkout that differs in one file; all else are links, so that compiled code is shared."""
    folder, original = code, REPOSITORY
    code.mkdir()
    for part in Path(path).parts:
        for file in original.iterdir():
            if file.name != part:
                (folder / file.name).symlink_to(file)
        folder, original = folder / part, original / part
        if original.is_dir():
            folder.mkdir()
    text = original.read_text()
    assert old in text
    folder.write_text(text.replace(old, new))
    return code


def test_two_states_of_the_code(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The other code weights the newest rays a little more, from the fourth frame on."""
    code = checkout_with(
        tmp_path / "code",
        "proground_log/mapping/neural/online_mapper.py",
        "ray_weights[:current] = 1.0",
        "ray_weights[:current] = 1.0 + (self._frame.index > 2) / 8",
    )
    log = json.loads(RunFolder(run).manifest.read_text())["log_path"]

    def show_it(entries: list[Entry]) -> list[Entry]:
        step = next(e for e in entries if e["event"] == "step" and e["frame"] == 3)
        step["losses"]["total"] = "0" * 8
        return entries

    other = edited_run(run, tmp_path / "other", show_it)
    arguments = ["bisect", run, other, "-o", tmp_path / "out", "--code-b", code, "--log", log]
    monkeypatch.setattr(sys, "argv", ["pglog", *(str(a) for a in arguments), "--json"])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 1
    found = json.loads(capsys.readouterr().out)["found"]
    assert (found["frame"], found["iteration"]) == (3, 0)
    assert found["frames_equal"] == 3
    assert found["tensors"]["optimiser/0/exp_avg"]["distance"] > 0


def test_what_is_no_checkout_is_named(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["bisect", run, run, "-o", tmp_path / "out", "--code-a", tmp_path]
    monkeypatch.setattr(sys, "argv", ["pglog", *(str(argument) for argument in arguments)])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    assert "is no checkout" in capsys.readouterr().err
