"""Asking a finished run where something is: by a text, or by a picture of it (paper, Sec. 5.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import expit, logit

from proground_log.errors import ProgroundError
from proground_log.log.reader import LogReader
from proground_log.mapping.map import BACKGROUND
from proground_log.mapping.objects import SceneObject
from proground_log.perception.description import PerceptionDescription
from proground_log.perception.map_texts import Texts, texts_for
from proground_log.perception.of_log import prompt_of
from proground_log.query.attributes import COLORS, SHARE, color_names, light_of
from proground_log.query.grounding import MARGIN, relevance_to, z_scores
from proground_log.query.image_query import ImageQuery, embed_image
from proground_log.query.objects import LEAST_RELEVANCE
from proground_log.query.parse import Query, parse_query
from proground_log.query.relations import RELATIONS
from proground_log.query.surface import Surface, Surfaces

NOT_MARGIN = 1.0
"""What a query must not be has to fit a thing so much less than the query, in logits."""


@dataclass(frozen=True)
class Measure:
    """What a score is.

    Args:
        name: what people call it.
        threshold: objects count from here on.
        full: where the colours of a picture end.
    """

    name: str
    threshold: float
    full: float


RELEVANCE = Measure("relevance", threshold=LEAST_RELEVANCE / 2, full=1.0)
"""The detector's own sigmoid, the mean over what it saw of a thing. Another name for a thing scores
less than its prompt, and what only resembles it is told apart by the margin to the best text: so
the threshold can be this low."""
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
        things: what was found, best first; the score of each is for the query.
        best: the best score of any object for the thing asked for, before its colour and its
            relations are looked at; 0 at least.
        scores: float32 [V], what the map says of its vertices.
        notes: what a reader of the answer should know.
    """

    query: str
    measure: Measure
    things: tuple[SceneObject, ...]
    best: float
    scores: np.ndarray
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Question:
    """What is asked, understood.

    Args:
        names: the texts, as they were given.
        queries: what they mean.
        rows: the row of each prompt and name in the embeddings.
        embeddings: float32 [K, 512]: the task's prompts, other names, and then an image and its
            bank.
        image: where there is one: its name, and its row.
    """

    names: tuple[str, ...]
    queries: tuple[Query, ...]
    rows: Mapping[str, int]
    embeddings: np.ndarray
    image: tuple[str, int] | None


def understand(
    names: Sequence[str],
    description: PerceptionDescription,
    image: ImageQuery | None = None,
    texts: Texts = Texts(),
    log: LogReader | None = None,
) -> Question:
    """Embed what is asked.

    Args:
        names: what to look for, as `parse_query` reads it; each competes with the task's prompts,
            not with the others.
        description: of the map that will be asked.
        image: a picture to look for; then the log has to be there.
        texts: embeddings of texts that the map does not know.
        log: the run's.

    Raises:
        ProgroundError: nothing is asked, nobody knows a text, or a file is not what it should be.
    """
    two_spaces = texts.vocabulary is not None and texts.text_encoder is not None
    faults = (
        (not names and image is None, "there is nothing to look for", "give a text or --image"),
        (two_spaces, "--vocabulary and --text-encoder are both given", "leave one out"),
    )
    for is_fault, what, todo in faults:
        if is_fault:
            raise ProgroundError(what, where="query", todo=todo)
    queries = tuple(parse_query(name, description.task.all_prompts) for name in names)
    rows, embeddings = _embed(queries, description, texts)
    if image is None:
        return Question(tuple(names), queries, rows, embeddings, None)
    assert log is not None
    pictures = embed_image(image, log)
    named = image.image.name, len(embeddings)
    return Question(tuple(names), queries, rows, np.concatenate([embeddings, pictures]), named)


def query(
    surfaces: Surfaces,
    names: Sequence[str],
    voxel_m: float,
    top_k: int,
    *,
    image: ImageQuery | None = None,
    texts: Texts = Texts(),
) -> tuple[Surface, list[Answer]]:
    """Find things in the map of a run; what cannot be asked is refused before anything is done.

    Args:
        surfaces: of a finished run whose log had regions.
        names, image, texts: as for `understand`.
        voxel_m: voxels of the surface whose objects are asked.
        top_k: most things an answer has.

    Returns:
        The surface, and the answers.
    """
    run = surfaces.run
    run.require_meaning()
    assert run.map.description is not None
    log = None if image is None else run.log
    question = understand(names, run.map.description, image, texts, log)
    _require_some(top_k)
    surface = surfaces.at(voxel_m)
    return surface, query_surface(surface, question, top_k)


def query_surface(surface: Surface, question: Question, top_k: int) -> list[Answer]:
    """Find things on a surface.

    Args:
        surface: of the map that the question was understood for.
        question: what to look for.
        top_k: most things an answer has.

    Returns:
        An answer for each name, in their order; that for the image comes last.
    """
    _require_some(top_k)
    logits, background = surface.ask(question.embeddings)
    said = logits
    if surface.sightings is not None:
        said = surface.sightings.logits(surface.description.heads, question.embeddings)
    asked = _Asked(surface, question.rows, logits, background, _means(surface, expit(said)))
    pairs = zip(question.names, question.queries, strict=True)
    answers = [asked.answer(name, query, top_k) for name, query in pairs]
    if question.image is not None:
        name, row = question.image
        scores = z_scores(logits[:, row], logits[:, row + 1 :])
        scores[background >= BACKGROUND] = 0
        fits = _means(surface, z_scores(said[:, row], said[:, row + 1 :])[:, None])[:, 0]
        things = ranked(surface.objects, fits, fits >= Z_SCORE.threshold)[:top_k]
        answers.append(Answer(name, Z_SCORE, tuple(things), float(fits.max(initial=0)), scores))
    return answers


def _require_some(top_k: int) -> None:
    if top_k < 1:
        what = f"the best {top_k} are asked for"
        raise ProgroundError(what, where="query", todo="ask for 1 or more")


def ranked(
    objects: Sequence[SceneObject], scores: np.ndarray, chosen: np.ndarray
) -> list[SceneObject]:
    """The chosen (bool [N]) of N objects with new scores [N], best first."""
    order = [n for n in np.argsort(-scores, kind="stable").tolist() if chosen[n]]
    return [replace(objects[n], score=float(scores[n])) for n in order]


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


def _means(surface: Surface, values: np.ndarray) -> np.ndarray:
    """The mean of what each object's witnesses say, float64 [N, K], of values [W, K]."""
    rows = [values[thing.witnesses].mean(axis=0, dtype=np.float64) for thing in surface.objects]
    return np.array(rows).reshape(len(rows), values.shape[1])


@dataclass(frozen=True, eq=False)
class _Asked:
    """What is said of the texts of all queries.

    Args:
        surface: V vertices, N objects.
        rows: by text its column.
        logits: float [V, K], the map's; the task's prompts come first.
        background: float [V].
        relevance: float [N, K], of the objects.
    """

    surface: Surface
    rows: Mapping[str, int]
    logits: np.ndarray
    background: np.ndarray
    relevance: np.ndarray

    def answer(self, text: str, query: Query, top_k: int) -> Answer:
        """Find what is asked for."""
        things, others = self._found(query)
        notes = self._notes(query)
        if query.other is not None and not others:
            notes.append(f"nothing was found that is {query.other.name!r} to be {query.relation}")
        best = float(self.relevance[:, self._column(query.name)].max(initial=0))
        return Answer(
            text, RELEVANCE, tuple(things[:top_k]), best, self._scores(query), tuple(notes)
        )

    def _found(self, query: Query) -> tuple[list[SceneObject], list[SceneObject]]:
        """The things that a query means, and those it relates them to."""
        column = self._column(query.name)
        things = ranked(self.surface.objects, self.relevance[:, column], self._claimed(query))
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
        lies_so = RELATIONS[query.relation]
        related = [
            thing
            for thing in things
            # A cup near a mug is not near itself.
            if any(lies_so(thing.box, other.box) and thing.box is not other.box for other in others)
        ]
        return related, others

    def _claimed(self, query: Query) -> np.ndarray:
        """Which objects a query's name fits, bool [N]; see `relevance_to`."""
        column = self._column(query.name)
        chance = logit(self.relevance.clip(1e-6, 1 - 1e-6))
        competing = chance[:, [*range(self._prompts), column]].max(axis=1)
        claimed = self.relevance[:, column] >= RELEVANCE.threshold
        claimed &= chance[:, column] >= competing - MARGIN
        for name in query.without:
            claimed &= chance[:, column] - chance[:, self._column(name)] >= NOT_MARGIN
        return np.asarray(claimed)

    def _scores(self, query: Query) -> np.ndarray:
        """Relevance [V] to a query's name, 0 where what it must not be fits nearly as well."""
        asked = self.logits[:, self._column(query.name)]
        scores = relevance_to(asked, self._best_prompt, self.background)
        for name in query.without:
            scores[asked - self.logits[:, self._column(name)] < NOT_MARGIN] = 0
        return scores

    def _notes(self, query: Query) -> list[str]:
        notes = []
        for name in dict.fromkeys(query.names):
            if self._column(name) >= self._prompts:
                notes.append(
                    f"{name!r} is none of the task's prompts: only what these found can answer, "
                    "compared with its text; expect lower scores"
                )
            elif self._column(name) >= len(self.surface.description.task.prompts):
                notes.append(f"{name!r} is irrelevant to the task: no object is of it")
        return notes

    @cached_property
    def _best_prompt(self) -> np.ndarray:
        """The logit of the best of the task's prompts, [V]."""
        return np.asarray(self.logits[:, : self._prompts].max(axis=1))

    def _column(self, name: str) -> int:
        return self.rows[prompt_of(name)]

    @property
    def _prompts(self) -> int:
        return len(self.surface.description.texts)
