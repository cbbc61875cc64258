"""The command that asks a map: query."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.table import Column, Table
from tyro.conf import Positional

from pglog.common import SAME, AsJson, Run, err, out, warn
from proground_log.errors import ProgroundError
from proground_log.query.voxels import OBJECTS_VOXEL_M

if TYPE_CHECKING:
    from proground_log.query.ask import Answer


def query_command(
    run: Run,
    texts: Annotated[tuple[str, ...], Positional, tyro.conf.arg(metavar="[TEXT ...]")] = (),
    *,
    image: Path | None = None,
    image_encoder: Path | None = None,
    vocabulary: Path | None = None,
    text_encoder: Path | None = None,
    top_k: int = 5,
    voxel_m: float = OBJECTS_VOXEL_M,
    as_json: AsJson = False,
    rrd: Path | None = None,
    overwrite: bool = False,
    log: Path | None = None,
) -> int:
    """Say where things are: by a text, or by a picture of one.

    A text names a thing, if need be with a colour ("red chair"), with what it is not ("chair, not
    sofa"), and with where it is to another: on, under, above, in or near ("cup on table").

    Args:
        run: folder of a finished run, of a log with regions.
        texts: what to look for.
        image: a picture of what to look for, with --image-encoder.
        image_encoder: computes the picture's embedding (.onnx).
        vocabulary: embeddings of texts that are none of the task's prompts (.npz).
        text_encoder: computes the embeddings of such texts (.onnx).
        top_k: most things to name for each text.
        voxel_m: voxels of the surface that is asked.
        as_json: print JSON, for programs.
        rrd: a recording of the answers to write, for rerun (.rrd).
        overwrite: replace that recording.
        log: the run's log, where it has moved: it tells objects apart, and --image needs it.
    """
    from proground_log.files import require_free
    from proground_log.perception.map_texts import Texts
    from proground_log.query.ask import query
    from proground_log.query.image_query import ImageQuery
    from proground_log.query.surface import Surfaces
    from proground_log.run.opened import OpenedRun
    from proground_log.telemetry.query_recording import draw_answers

    if (image is None) != (image_encoder is None):
        raise ProgroundError(
            "--image and --image-encoder go together", where="query", todo="give both, or none"
        )
    if rrd is not None:
        require_free(rrd, overwrite=overwrite)
    with err.status("asking the map"):
        surface, answers = query(
            Surfaces(OpenedRun.finished(run, log)),
            texts,
            voxel_m,
            top_k,
            image=ImageQuery(image, image_encoder) if image and image_encoder else None,
            texts=Texts(vocabulary, text_encoder),
        )
        if rrd is not None:
            draw_answers(rrd, surface, answers)
    if surface.caveat:
        warn(surface.caveat)
    if as_json:
        print(json.dumps([_as_json(answer) for answer in answers], indent=2))
        return SAME
    _print(answers)
    if rrd is not None:
        print(f"look at it: pglog view {rrd}")
    return SAME


def _as_json(answer: Answer) -> dict[str, object]:
    from proground_log.exports.objects import box_json, rounded

    return {
        "query": answer.query,
        "measure": answer.measure.name,
        "threshold": answer.measure.threshold,
        "best_score": round(answer.best, 4),
        "notes": list(answer.notes),
        "things": [
            {
                "label": thing.label,
                "position_m": rounded(thing.position_m),
                "lower_m": rounded(thing.lower_m),
                "upper_m": rounded(thing.upper_m),
                "extent_m": rounded(thing.upper_m - thing.lower_m),
                "box": box_json(thing.box),
                "score": round(thing.score, 4),
                "vertices": len(thing.vertices),
                "views": thing.views,
            }
            for thing in answer.things
        ],
    }


def _print(answers: list[Answer]) -> None:
    from proground_log.exports.objects import place_text

    table = Table(
        *(Column(name, overflow="fold") for name in ("query", "rank", "object")),
        *(Column(name, justify="right") for name in ("position m", "extent m", "score")),
    )
    for answer in answers:
        for rank, thing in enumerate(answer.things, start=1):
            position = place_text(thing.position_m)
            extent = place_text(thing.box.extent_m, "x")
            # A relevance goes without saying; a z-score does not.
            unit = "" if answer.measure.name == "relevance" else f"{answer.measure.name} "
            score = f"{unit}{thing.score:.2f}"
            table.add_row(answer.query, str(rank), thing.label, position, extent, score)
    if table.row_count:
        out.print(table)
    for answer in answers:
        if not answer.things:
            print(f"{answer.query}: nothing found; {_why_nothing(answer)}")
        for note in answer.notes:
            print(f"{answer.query}: {note}")


def _why_nothing(answer: Answer) -> str:
    measure = answer.measure
    best = f"the best {measure.name} of an object is {answer.best:.2f}"
    if answer.best < measure.threshold:
        return f"{best}, and {measure.threshold:.2f} is needed"
    return f"{best}, but another text fits that better, or it is not as asked besides"
