"""The command that measures this machine for simulated real time: calibrate."""

from __future__ import annotations

import json
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.table import Column, Table

from pglog.common import (
    SAME,
    AsJson,
    Output,
    out,
    shown_progress,
)
from proground_log.errors import ProgroundError
from proground_log.frame import Selection
from proground_log.mapping.kinds import NEURAL

if TYPE_CHECKING:
    from proground_log.perception.onnx.perceiver import OnnxPerception
    from proground_log.run.cost_model import CostModel
    from replay.calibration.measure import Points


def calibrate_command(
    *,
    output: Output,
    name: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    mapper: Annotated[str, tyro.conf.arg(metavar="KIND")] = NEURAL,
    threads: int | None = None,
    detector: Path | None = None,
    segmenter: Path | None = None,
    vocabulary: Path | None = None,
    as_json: AsJson = False,
    overwrite: bool = False,
) -> int:
    """Measure in about a minute what each stage of a replay takes on this machine.

    Let nothing else run meanwhile. What comes out is for `pglog replay --cost`.

    Args:
        output: the cost model to write (.json).
        name: of the cost model; by default that of the file.
        mapper: the kind whose stages are measured.
        threads: compute on so many.
        detector: measure perception with it, too (.onnx).
        segmenter: and with it, for masks (.onnx).
        vocabulary: embeddings of the prompts, for the detector (.npz).
        as_json: print JSON, for programs.
        overwrite: replace the output.
    """
    from proground_log.files import require_free
    from proground_log.log.reader import LogReader
    from recorders.record import record
    from recorders.room import RoomSource
    from replay.calibration.measure import REPEATS, cost_model, how_measured, measure
    from replay.calibration.work import FRAMES
    from replay.device import set_threads

    require_free(output, overwrite=overwrite)
    set_threads(threads)
    room = RoomSource(frames=FRAMES)
    perceiver = _perceiver(room.label_names, detector, segmenter, vocabulary)
    with tempfile.TemporaryDirectory(prefix="pglog-") as folder:
        log = Path(folder, "room.mcap")
        with shown_progress("record") as progress:
            record(room, "room", log, Selection(), overwrite=False, progress=progress)
        with shown_progress("calibrate") as progress:
            points = measure(LogReader(log), perceiver=perceiver, kind=mapper, progress=progress)
    perceived_with = _networks(detector, segmenter) if detector is not None else None
    model = cost_model(name or output.stem, points, how_measured(REPEATS, perceived_with))
    model.write(output)
    if as_json:
        measured = {stage: asdict(some) for stage, some in points.items()}
        print(json.dumps({**model.to_json(), "points": measured}, indent=2))
        return SAME
    _print(output, model, points)
    return SAME


def _perceiver(
    label_names: dict[int, str],
    detector: Path | None,
    segmenter: Path | None,
    vocabulary: Path | None,
) -> OnnxPerception | None:
    """The perception to measure, for all that the vocabulary knows of the room."""
    from proground_log.perception.of_log import prompt_of
    from proground_log.perception.onnx.perceiver import OnnxPerception
    from proground_log.perception.task import Task
    from proground_log.perception.vocabulary import Vocabulary

    if detector is None or vocabulary is None:
        if any((detector, segmenter, vocabulary)):
            raise ProgroundError(
                "perception is measured with --detector and --vocabulary",
                where="calibrate",
                todo="give both, or none of --detector, --segmenter and --vocabulary",
            )
        return None
    texts = Vocabulary(vocabulary)
    wanted = dict.fromkeys(prompt_of(name) for name in label_names.values())
    prompts = tuple(prompt for prompt in wanted if prompt in texts.names)
    if not prompts:
        raise ProgroundError(
            "knows none of the room's things",
            where=vocabulary,
            todo=f"give a vocabulary with some of {', '.join(wanted)}",
        )
    return OnnxPerception(Task("room", prompts), texts, detector, segmenter)


def _networks(detector: Path, segmenter: Path | None) -> str:
    """What perception was measured, in words: "a YOLOv8n-seg detector at 640 px"."""
    from proground_log.perception.onnx.detector import Detector
    from proground_log.perception.onnx.yolo import input_side

    side = input_side(Detector(detector).model)
    beside = "" if segmenter is None else f" and a {segmenter.stem} segmenter"
    return f"a {detector.stem} detector at {side} px{beside}"


def _print(output: Path, model: CostModel, points: dict[str, Points]) -> None:
    numbers = ("fixed ms", "ns a unit", "residual %", "sizes")
    table = Table("stage", "unit", *(Column(name, justify="right") for name in numbers))
    for stage, cost in model.stages.items():
        table.add_row(
            stage,
            cost.unit,
            f"{1e-6 * cost.fixed_ns:.2f}",
            f"{cost.per_unit_ns:,.1f}",
            f"{cost.residual_percent:.1f}",
            str(len(points[stage].units)),
        )
    hardware = ", ".join(f"{key} {value}" for key, value in model.hardware.items())
    print(f"{output}: cost model {model.name} of {hardware}")
    out.print(table)
