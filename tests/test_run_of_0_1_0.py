"""A run that version 0.1.0 wrote is read by every command, but not gone on with."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from proground_log.mapping.map_file import load_map, save_map
from proground_log.run.manifest import Manifest
from tests.commands import Pglog

FIXTURE = Path(__file__).parent / "fixtures" / "run-0.1.0"
ANSWERS: dict[str, Any] = json.loads((FIXTURE / "answers.json").read_text())
"""What the commands of 0.1.0 printed about it, as JSON."""


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """The run, where its log lies beside it."""
    folder = tmp_path / "run"
    folder.mkdir()
    for name in ("manifest.json", "ledger.jsonl", "map.safetensors"):
        shutil.copy(FIXTURE / name, folder)
    return folder


LOG = FIXTURE / "room.mcap"


def test_it_is_judged_as_it_was(run: Path, pglog: Pglog) -> None:
    answer = pglog("evaluate", run, "--log", LOG, "--json")
    assert answer.code == 0, answer.err
    scores = json.loads(answer.out)["scores"]
    assert scores.keys() == ANSWERS["evaluate"]["scores"].keys()
    for name, value in ANSWERS["evaluate"]["scores"].items():
        assert scores[name] == pytest.approx(value, rel=1e-3), name


@pytest.mark.parametrize("command", ["objects", "query"])
def test_it_answers_as_it_did(run: Path, pglog: Pglog, command: str) -> None:
    texts = ("bed", "rug") if command == "query" else ()
    answer = pglog(command, run, *texts, "--log", LOG, "--json")
    assert answer.code == 0, answer.err
    assert_close(json.loads(answer.out), ANSWERS[command])


def assert_close(found: Any, expected: Any) -> None:
    """Equal but for the last digits of numbers."""
    if isinstance(expected, dict):
        assert found.keys() == expected.keys()
        for name, value in expected.items():
            assert_close(found[name], value)
    elif isinstance(expected, list):
        assert len(found) == len(expected)
        for mine, theirs in zip(found, expected, strict=True):
            assert_close(mine, theirs)
    elif isinstance(expected, float):
        assert found == pytest.approx(expected, abs=2e-3)
    else:
        assert found == expected


@pytest.mark.parametrize(
    ("what", "name"),
    [
        ("mesh", "mesh.ply"),
        ("points", "points.ply"),
        ("openlex3d", "openlex3d"),
        ("occupancy", "floor.yaml"),
        ("objects", "objects.json"),
        ("mcap", "map.mcap"),
    ],
)
def test_it_is_exported(run: Path, tmp_path: Path, pglog: Pglog, what: str, name: str) -> None:
    answer = pglog("export", run, what, "-o", tmp_path / name, "--log", LOG, "--voxel-m", 0.08)
    assert answer.code == 0, answer.err
    assert (tmp_path / name).exists()


def test_it_is_reported_and_compared(run: Path, tmp_path: Path, pglog: Pglog) -> None:
    assert pglog("report", run, "-o", tmp_path / "run.html", "--log", LOG).code == 0
    other = tmp_path / "other"
    shutil.copytree(run, other)
    assert pglog("diff", run, other, "--all").code == 0


def test_its_map_is_written_anew_as_it_was(run: Path, tmp_path: Path) -> None:
    before = load_map(run / "map.safetensors")
    save_map(tmp_path / "map.safetensors", before)
    after = load_map(tmp_path / "map.safetensors")
    assert before.kind == after.kind == "neural"
    assert before.header() == after.header()
    for name, tensor in before.tensors().items():
        assert (tensor == after.tensors()[name]).all(), name


def test_its_settings_are_those_of_the_neural_mapper(run: Path) -> None:
    config = Manifest.read(run / "manifest.json").config
    assert config.kind == "neural"
    assert config.mapper.sampling.rays == 256


def test_who_wants_to_go_on_with_it_is_told_the_version(
    run: Path, tmp_path: Path, pglog: Pglog
) -> None:
    again = tmp_path / "again"
    for words in (
        ("replay", LOG, "-o", run, "--resume"),
        ("rerun", run, "-o", again, "--log", LOG),
        ("replay", LOG, "-o", again, "--manifest", run / "manifest.json"),
    ):
        answer = pglog(*words)
        assert answer.code == 2
        assert "0.1.0" in answer.err
        assert not again.exists()
