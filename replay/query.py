"""Asking a finished run where something is: by a text, or by a picture of it (paper, Sec. 5.3)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from proground_log.errors import ProgroundError
from proground_log.events import MeshExtracted
from proground_log.files import require_file
from proground_log.locations import located
from proground_log.log.reader import LogReader
from proground_log.mapping.map_file import load_map
from proground_log.perception.description import PerceptionDescription
from proground_log.perception.image_encoder import OnnxImageEncoder
from proground_log.perception.map_texts import texts_for
from proground_log.perception.of_log import prompt_of
from proground_log.query.attributes import COLORS, SHARE, color_names, light_of
from proground_log.query.boxes import OrientedBox, box_around
from proground_log.query.grounding import BACKGROUND, relevance_to, z_scores
from proground_log.query.instances import Instance, find_instances
from proground_log.query.parse import Query, parse_query
from proground_log.query.relations import RELATIONS
from proground_log.query.surface import Mesh
from proground_log.telemetry.query_recording import QueryDrawing, write_query_recording
from replay.evaluate import Texts
from replay.manifest import Manifest, file_sha256, open_log_of
from replay.objects import (
    Surface,
    log_if_there,
    require_meaning,
    require_voxels,
    surface_of,
)
from replay.run_folder import RunFolder

GAP_VOXELS = 3
"""Vertices this near are of one thing: a crack of a voxel or two must not split it."""
NOT_MARGIN = 1.0
"""What a query must not be has to fit a vertex so much less than the query, in logits."""
LEAST_AREA_M2 = 0.02
"""Of a thing: half a cup's. Smaller spots are specks of noise."""
BANK_FRAMES, BANK_SIDE = 12, 2
"""The bank behind an image query: so many frames, each cut into a grid of that side."""


@dataclass(frozen=True)
class Measure:
    """What a score is.

    Args:
        name: what people call it.
        threshold: vertices count from here on.
        full: where the colours of a picture end.
    """

    name: str
    threshold: float
    full: float


RELEVANCE = Measure("relevance", threshold=0.2, full=1.0)
"""The detector's own sigmoid. A prompt scores 0.5 and more on its things, but another name for one
far less: mug on a cup 0.26. What only resembles a thing is told apart by the margin to the best
text, so that the threshold can be this low."""
Z_SCORE = Measure("z", threshold=2.5, full=5.0)
"""Standard deviations above the bank. The bank is of the same place and so has the thing in it:
what fills a share p of its crops reaches no more than sqrt((1 - p) / p), so that a threshold of 3
would lose what is on every tenth. On the built-in room, with embeddings drawn for the crops' true
classes, 2.5 keeps nine tenths of the right vertices that 2 finds, and two thirds of the wrong ones.
"""


@dataclass(frozen=True)
class Answer:
    """Where a query is.

    Args:
        query: the text, or the name of the image's file.
        measure: what the scores are.
        scores: float32 [V], of the mesh's vertices; those of the thing asked for, before its
            colour and its relations are looked at.
        things: what was found, best first.
        boxes: the upright box of each.
        notes: what a reader of the answer should know.
    """

    query: str
    measure: Measure
    scores: np.ndarray
    things: tuple[Instance, ...]
    boxes: tuple[OrientedBox, ...]
    notes: tuple[str, ...] = ()

    @property
    def best(self) -> float:
        """The best score of any vertex."""
        return float(self.scores.max())


@dataclass(frozen=True)
class ImageQuery:
    """A picture of what to look for, and the encoder (.onnx) that puts it in a text's place."""

    image: Path
    encoder: Path


def query_run(
    run_path: Path,
    names: Sequence[str],
    voxel_m: float,
    top_k: int,
    *,
    image: ImageQuery | None = None,
    texts: Texts = Texts(),
    log_path: Path | None = None,
) -> tuple[Mesh, list[Answer]]:
    """Find things in the map of a run.

    Args:
        run_path: folder of a finished run whose log had regions.
        names: what to look for, as `parse_query` reads it; each competes with the task's prompts,
            not with the others.
        voxel_m: voxels of the mesh whose vertices are asked.
        top_k: most things an answer has.
        image: a picture to look for.
        texts: embeddings of texts that the map does not know.
        log_path: the run's log, or None where it is where the run found it; `image` needs it, and
            without it z is up.

    Returns:
        The mesh, and an answer for each name, in their order; that for the image comes last.

    Raises:
        ProgroundError: the run has no meaning or no surface, nobody knows a text, or a file is
            not what it should be.
    """
    _require_sound(names, image, texts, voxel_m, top_k)
    run = RunFolder(run_path).require_finished()
    content = load_map(run.map)
    require_meaning(content, run_path)
    log = log_if_there(run, log_path)
    assert content.semantics is not None
    description = content.semantics.description
    queries = [parse_query(name, description.task.all_prompts) for name in names]
    rows, embeddings = _embed(queries, description, texts)
    known = len(embeddings)
    if image is not None:
        embeddings = np.concatenate([embeddings, _embed_image(image, run, log_path)])
    surface = surface_of(content, voxel_m, log, run_path)
    logits, background = surface.ask(embeddings)
    asked = _Asked(surface, rows, logits, background)
    answers = [asked.answer(name, query, top_k) for name, query in zip(names, queries, strict=True)]
    if image is not None:
        scores = z_scores(logits[:, known], logits[:, known + 1 :])
        scores[background >= BACKGROUND] = 0
        things = asked.things(Z_SCORE, scores)[:top_k]
        boxes = asked.boxes(things)
        answers.append(Answer(image.image.name, Z_SCORE, scores, tuple(things), tuple(boxes)))
    return surface.mesh, answers


def draw_answers(
    path: Path, run_path: Path, mesh: Mesh, answers: Sequence[Answer], log_path: Path | None = None
) -> None:
    """Write a rerun recording with a tab for each answer.

    Args:
        path: the .rrd file, replaced if it is there.
        run_path: folder of the run.
        mesh, answers: as `query_run` gives them.
        log_path: the run's log, or None where it is where the run found it; its camera says which
            way is up, and without it z is.
    """
    run = RunFolder(run_path)
    log_path = log_path or located(Manifest.read(run.manifest).log_path)
    pose = next(LogReader(log_path).frames([0])).world_from_camera if log_path.is_file() else None
    drawings = [
        QueryDrawing(
            query=answer.query,
            heat=np.clip(answer.scores / answer.measure.full, 0, 1),
            lower_m=np.array([thing.lower_m for thing in answer.things]).reshape(-1, 3),
            upper_m=np.array([thing.upper_m for thing in answer.things]).reshape(-1, 3),
            labels=[f"{answer.query} {thing.score:.2f}" for thing in answer.things],
        )
        for answer in answers
    ]
    surface = MeshExtracted(0, mesh.vertices_m, mesh.faces, mesh.normals, mesh.colors)
    queries = ", ".join(answer.query for answer in answers)
    recording_id = f"{file_sha256(run.map)[:16]}: {queries}"
    write_query_recording(path, recording_id, surface, drawings, world_from_camera=pose)


def _require_sound(
    names: Sequence[str], image: ImageQuery | None, texts: Texts, voxel_m: float, top_k: int
) -> None:
    """Raise a ProgroundError unless there is a question that can be answered."""
    two_spaces = texts.vocabulary is not None and texts.text_encoder is not None
    require_voxels(voxel_m)
    faults = (
        (not names and image is None, "there is nothing to look for", "give a text or --image"),
        (two_spaces, "--vocabulary and --text-encoder are both given", "leave one out"),
        (top_k < 1, f"the best {top_k} are asked for", "ask for 1 or more"),
    )
    for is_fault, what, todo in faults:
        if is_fault:
            raise ProgroundError(what, where="query", todo=todo)


def _embed(
    queries: Sequence[Query], description: PerceptionDescription, texts: Texts
) -> tuple[dict[str, int], np.ndarray]:
    """The row of each prompt and name, and the embeddings: of the prompts, then of other names."""
    space = texts_for(description, texts.vocabulary, texts.text_encoder)
    rows = {prompt: row for row, prompt in enumerate(description.task.all_prompts)}
    embeddings = [description.texts]
    for query in queries:
        for name in query.names:
            if prompt_of(name) not in rows:
                rows[prompt_of(name)] = len(rows)
                embeddings.append(space.embed([name]))
    return rows, np.concatenate(embeddings)


def _embed_image(query: ImageQuery, run: RunFolder, log_path: Path | None) -> np.ndarray:
    """Embeddings of the image and of its bank, [1 + B, 512]."""
    image, encoder = _read_image(query.image), OnnxImageEncoder(query.encoder)
    reader = open_log_of(Manifest.read(run.manifest), log_path)
    return np.stack([encoder.embed(picture) for picture in (image, *background_crops(reader))])


def _read_image(path: Path) -> np.ndarray:
    """An image file, uint8 [H, W, 3] RGB, the way up that its camera noted."""
    try:
        with Image.open(require_file(path)) as image:
            return np.asarray(ImageOps.exif_transpose(image).convert("RGB"))
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError) as error:
        raise ProgroundError(
            f"cannot be read as an image ({error})", where=path, todo="give a JPEG or PNG file"
        ) from error


def background_crops(reader: LogReader) -> Iterator[np.ndarray]:
    """Pieces of a log's colour images, uint8 [h, w, 3] RGB, that show nothing in particular.

    Frames evenly spaced over the log, each cut into a grid: 48 pieces, fewer of a short log.
    """
    frames = np.linspace(0, len(reader) - 1, BANK_FRAMES).round().astype(int)
    for sensor in reader.frames(np.unique(frames).tolist()):
        for band in np.array_split(sensor.decode_color(), BANK_SIDE, axis=0):
            yield from np.array_split(band, BANK_SIDE, axis=1)


@dataclass(frozen=True)
class _Asked:
    """What the map says of the texts of all queries.

    Args:
        surface: V vertices.
        rows: by text its column.
        logits: float [V, K]; the task's prompts come first.
        background: float [V].
    """

    surface: Surface
    rows: Mapping[str, int]
    logits: np.ndarray
    background: np.ndarray

    def answer(self, text: str, query: Query, top_k: int) -> Answer:
        """Find what is asked for."""
        things, others = self._found(query)
        notes = self._notes(query)
        if query.other is not None and not others:
            notes.append(f"nothing was found that is {query.other.name!r} to be {query.relation}")
        things = things[:top_k]
        scores = self._scores(query)
        return Answer(
            text, RELEVANCE, scores, tuple(things), tuple(self.boxes(things)), tuple(notes)
        )

    def things(self, measure: Measure, scores: np.ndarray) -> list[Instance]:
        """Group the vertices that score well."""
        mesh, voxel_m = self.surface.mesh, self.surface.voxel_m
        return find_instances(
            mesh.vertices_m,
            mesh.faces,
            scores,
            threshold=measure.threshold,
            most_gap_m=GAP_VOXELS * voxel_m,
            # A surface has a vertex or more for each of the voxels' faces that it crosses.
            least_vertices=math.ceil(LEAST_AREA_M2 / voxel_m**2),
        )

    def boxes(self, things: Sequence[Instance]) -> list[OrientedBox]:
        """The upright box of each."""
        vertices_m, up = self.surface.mesh.vertices_m, self.surface.up
        return [box_around(vertices_m[thing.vertices], up) for thing in things]

    def _found(self, query: Query) -> tuple[list[Instance], list[Instance]]:
        """The things that a query means, and those it relates them to."""
        things = self.things(RELEVANCE, self._scores(query))
        if query.color is not None:
            colors = self.surface.mesh.colors
            wanted, light = COLORS.index(query.color), light_of(colors)
            things = [
                thing
                for thing in things
                if (color_names(colors[thing.vertices], light) == wanted).mean() >= SHARE
            ]
        if query.relation is None or query.other is None:
            return things, []
        others, _ = self._found(query.other)
        lies_so, boxes = RELATIONS[query.relation], self.boxes(others)
        related = [
            thing
            for thing, box in zip(things, self.boxes(things), strict=True)
            if any(
                lies_so(box, other_box)
                for other, other_box in zip(others, boxes, strict=True)
                # A cup near a mug is not near itself.
                if not np.intersect1d(thing.vertices, other.vertices).size
            )
        ]
        return related, others

    def _scores(self, query: Query) -> np.ndarray:
        """Relevance [V] to a query's name, 0 where what it must not be fits nearly as well."""
        column = self.rows[prompt_of(query.name)]
        # A query that is a prompt does not compete with itself.
        competing = list(dict.fromkeys([*range(self._prompts), column]))
        scores = relevance_to(competing.index(column), self.logits[:, competing], self.background)
        for name in query.without:
            lead = self.logits[:, column] - self.logits[:, self.rows[prompt_of(name)]]
            scores[lead < NOT_MARGIN] = 0
        return scores

    def _notes(self, query: Query) -> list[str]:
        return [
            f"{name!r} is none of the task's prompts: compared through its text alone, "
            "expect lower scores"
            for name in dict.fromkeys(query.names)
            if self.rows[prompt_of(name)] >= self._prompts
        ]

    @property
    def _prompts(self) -> int:
        return len(self.surface.description.texts)
