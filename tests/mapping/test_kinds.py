"""Mappers of other packages fit without touching this one; a broken one harms none."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from proground_log.errors import ProgroundError
from proground_log.log.reader import LogReader
from proground_log.mapping import bench
from proground_log.mapping.kinds import mapper_kind
from proground_log.run.folder import RunFolder
from proground_log.run.ledger import read_ledger
from proground_log.run.manifest import Manifest
from proground_log.run.settings import ReplayConfig, from_dict, with_kind, with_setting
from replay.calibration import work
from replay.calibration.measure import measure
from replay.session import replay
from tests.commands import Pglog
from tests.replay.golden import perceiver_of
from tests.telemetry.telemetry_cells import rows_of

pytestmark = pytest.mark.slow

EXAMPLE = Path(__file__).parents[2] / "examples" / "points_mapper"
BROKEN = {
    "broken": ("raise ValueError('out of order')", "ValueError: out of order"),
    "no_kind": ("KIND = 3", "is a int, not a MapperKind"),
    "melting": (
        "from dataclasses import dataclass\n"
        "from proground_log.mapping.kinds import MapperKind\n"
        "@dataclass\nclass Settings:\n    size: int = 1\n"
        "KIND = MapperKind(Settings, None, None)",
        "no frozen dataclass",
    ),
}
"""What else is installed: by kind its code, and what is said of it."""


@pytest.fixture(scope="module", autouse=True)
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The example, and packages that do not work, as pip installs them."""
    folder = tmp_path_factory.mktemp("packages")
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--target", str(folder)]
    pip = [sys.executable, "-m", "pip", "install", *options, str(EXAMPLE)]
    subprocess.run(pip, check=True, capture_output=True)
    for kind, (code, _) in BROKEN.items():
        (folder / f"{kind}_package.py").write_text(code + "\n")
        info = folder / f"{kind}_package-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {kind}-package\nVersion: 1\n")
        entry = f"[proground_log.mappers]\n{kind} = {kind}_package:KIND\n"
        (info / "entry_points.txt").write_text(entry)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        mapper_kind.cache_clear()
        yield
    mapper_kind.cache_clear()


@pytest.fixture(scope="module")
def run(room_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the example mapper, with meaning and telemetry."""
    path = tmp_path_factory.mktemp("points") / "run"
    replay(room_log, path, points_config(), perceiver=perceiver_of(room_log))
    return path


def points_config() -> ReplayConfig:
    config = with_kind(ReplayConfig(hold_out_every=4, digest_every=3, checkpoint_every=4), "points")
    return with_setting(config, "mapper.voxel_m", 0.06)


def entries_of(run: Path, event: str) -> list[dict[str, object]]:
    return [entry for entry in read_ledger(RunFolder(run).ledger) if entry["event"] == event]


def test_its_frames_counts_and_fingerprints_are_in_the_ledger(run: Path) -> None:
    done = entries_of(run, "done")
    assert len(done) == 12
    counts = [entry["points"]["voxels"] for entry in done]  # type: ignore[index]
    assert counts == sorted(counts)
    assert counts[-1] > counts[0] > 0
    assert entries_of(run, "step") == []
    states = entries_of(run, "state")
    assert len(states) == 12 // 3 + 1
    assert {"surface/keys", "regions/sums"} <= set(states[-1]["digests"])  # type: ignore[arg-type]


def test_stopped_and_resumed_it_ends_in_the_same_ledger(
    run: Path, room_log: Path, tmp_path: Path, pglog: Pglog
) -> None:
    again, perception = tmp_path / "run", ("--simulated", "--simulated-seed", 0)
    flags = ("--hold-out-every", 4, "--digest-every", 3, "--checkpoint-every", 4)
    first = ("--mapper", "points", "--mapper.voxel-m", 0.06, *flags, "--until-frame", 5)
    assert pglog("replay", room_log, "-o", again, *first, *perception).code == 0
    resumed = pglog("replay", room_log, "-o", again, "--resume", *perception)
    assert resumed.code == 0, resumed.err
    assert RunFolder(again).ledger.read_bytes() == RunFolder(run).ledger.read_bytes()
    assert pglog("diff", run, again).code == 0
    checked = tmp_path / "checked"
    assert pglog("rerun", run, "-o", checked, "--check", *perception).code == 0


def test_its_recording_shows_what_it_counts_and_its_surface(run: Path) -> None:
    entities = {entity for entity, _ in rows_of(RunFolder(run).telemetry)}
    assert {"/points/voxels", "/world/map/color", "/world/map/semantics"} <= entities
    assert "/view/rendered/labels" in entities
    assert not any(entity.startswith("/loss") for entity in entities)


def test_it_is_judged_asked_reported_and_exported(run: Path, tmp_path: Path, pglog: Pglog) -> None:
    judged = json.loads(pglog("evaluate", run, "--json", "--voxel-m", 0.05).out)["scores"]
    assert judged["psnr_db"] > 11
    assert judged["depth_l1_cm"] < 6
    assert judged["accuracy_cm"] < 6
    assert judged["top1_percent"] > 50
    things = json.loads(pglog("query", run, "bed", "--json", "--voxel-m", 0.06).out)[0]["things"]
    assert [thing["label"] for thing in things[:1]] == ["bed"]
    assert pglog("report", run, "-o", tmp_path / "run.html").code == 0
    for what, name in (("mesh", "a.glb"), ("openlex3d", "lex"), ("mcap", "a.mcap")):
        answer = pglog("export", run, what, "-o", tmp_path / name, "--voxel-m", 0.06)
        assert answer.code == 0, answer.err


def test_no_steps_are_counted_nor_missed_where_it_does_none(
    room_log: Path, tmp_path: Path, pglog: Pglog
) -> None:
    answer = pglog("replay", room_log, "-o", tmp_path / "run", "--mapper", "points")
    assert answer.code == 0
    assert "learnt nothing" not in answer.err
    result = Manifest.read(RunFolder(tmp_path / "run").manifest).result
    assert result is not None
    assert "steps" not in result
    assert "steps" not in result["simulation"]


def test_its_settings_are_flags_and_stand_in_the_manifest(run: Path, pglog: Pglog) -> None:
    config = Manifest.read(RunFolder(run).manifest).config
    assert (config.kind, config.mapper.voxel_m) == ("points", 0.06)
    assert config == points_config()
    shown = pglog("replay", "--mapper", "points", "--help").out
    assert "--mapper.voxel-m" in shown
    assert "--mapper.sampling.rays" not in shown
    assert "--mapper.voxel-m" not in pglog("replay", "--help").out


def test_a_sweep_sets_them(room_log: Path, tmp_path: Path, pglog: Pglog) -> None:
    flags = ("--budget-ms", 200, "--max-frames", 3, "--hold-out-every", 3, "--voxel-m", 0.1)

    def settings_of(*asked: object) -> list[dict[str, object]]:
        output = tmp_path / str(len(list(tmp_path.iterdir())))
        answer = pglog("sweep", room_log, "-o", output, *flags, "--workers", 1, *asked)
        assert answer.code == 0, answer.err
        return [c["settings"] for c in json.loads((output / "sweep.json").read_text())["cells"]]

    of_points = settings_of("--mapper", "points", "--set", "mapper.voxel_m=0.08,0.1")
    assert of_points == [{"mapper.voxel_m": 0.08}, {"mapper.voxel_m": 0.1}]
    assert settings_of("--set", "mapper=neural,points") == [{"kind": "neural"}, {"kind": "points"}]


def test_its_stages_are_measured(room_log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(work, "WIDTHS", (32, 64))
    monkeypatch.setattr(bench, "FRAMES_BEFORE", 2)
    points = measure(LogReader(room_log), kind="points", repeats=1, progress=lambda *_: None)
    assert list(points) == ["decode", "insert"]
    assert points["insert"].units == (32 * 24, 64 * 48)


@pytest.mark.parametrize("kind", BROKEN)
def test_a_package_that_does_not_work_is_named_and_breaks_nothing_else(
    run: Path, room_log: Path, tmp_path: Path, pglog: Pglog, kind: str
) -> None:
    answer = pglog("replay", room_log, "-o", tmp_path / "run", "--mapper", kind)
    assert answer.code == 2
    assert kind in answer.err
    assert BROKEN[kind][1] in answer.err
    assert pglog("info", room_log).code == 0
    assert pglog("evaluate", run, "--voxel-m", 0.1).code == 0


def test_a_kind_that_nobody_brings_names_the_nearest(room_log: Path, pglog: Pglog) -> None:
    answer = pglog("replay", room_log, "-o", "run", "--mapper", "point")
    assert answer.code == 2
    assert "did you mean points?" in answer.err


def test_an_unknown_setting_is_no_setting() -> None:
    with pytest.raises(TypeError):
        from_dict(mapper_kind("points").settings, {"voxel": 3})
    with pytest.raises(ProgroundError, match="there is no mapper 'none'"):
        mapper_kind("none")
