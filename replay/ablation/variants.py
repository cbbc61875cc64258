"""Ablations: the paper's Tables 2, 3 and 4 and Fig. 4, on any log whose labels are known.

The semantic heads never touch geometry and colour, so one pass over the log trains the heads of
all variants side by side, each with exactly the result of a replay of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from proground_log.errors import ProgroundError
from proground_log.evaluation.semantics import labelled_points_of_log, semantic_scores
from proground_log.evaluation.top_k import TopK
from proground_log.field.config import SemanticSpace
from proground_log.log.reader import LogReader
from proground_log.log.registration import Registration
from proground_log.mapping.neural.config import SemanticsConfig
from proground_log.mapping.neural.neural_map import NeuralMap
from proground_log.mapping.neural.online_mapper import OnlineMapper
from proground_log.mapping.neural.semantic_learner import SemanticLearner
from proground_log.mapping.neural.semantic_map import SemanticMap
from proground_log.perception.perceiver import Perceiver
from proground_log.perception.task import Task
from proground_log.perception.texts import TextSpace
from proground_log.query.mesh import extract_mesh
from proground_log.run.settings import ReplayConfig
from proground_log.streams import stream
from replay.device import choose_device

IRRELEVANT_SHARES = (0.0, 0.2, 0.5, 1.0)
"""Irrelevant prompts for each prompt of the task (Table 3)."""
COVERAGE_VOXEL_M = 0.04


@dataclass(frozen=True)
class Variant:
    """One row of a table.

    Args:
        name: what the table calls it.
        settings: how its heads learn.
        task: what is looked for, where it is not the log's own task.
    """

    name: str
    settings: SemanticsConfig
    task: Task | None = None

    @property
    def perception(self) -> str:
        """What tells its regions from those of other variants."""
        return self.task.sha256 if self.task is not None else "the log's task"


@dataclass(frozen=True)
class Outcome:
    """What became of a variant.

    Args:
        scores: its Top-K accuracy.
        semantic_losses: the semantic loss of every step.
    """

    scores: TopK
    semantic_losses: list[float]


def weighting_and_filtering(settings: SemanticsConfig) -> list[Variant]:
    """Table 2: is a region weighted by its relevance, are irrelevant regions left out?"""
    names = {
        (False, False): "neither",
        (True, False): "weighting",
        (False, True): "filtering",
        (True, True): "both",
    }
    return [
        Variant(name, replace(settings, weight_regions=weight, filter_regions=keep))
        for (weight, keep), name in names.items()
    ]


def irrelevant_prompts(
    settings: SemanticsConfig, task: Task, names: Sequence[str], seed: int
) -> list[Variant]:
    """Table 3: the task with irrelevant prompts drawn from `names`, each larger set with the last.

    Raises:
        ProgroundError: there are fewer names than prompts.
    """
    if len(names) < len(task.prompts):
        raise ProgroundError(
            f"there are {len(names)} irrelevant names for {len(task.prompts)} prompts",
            where=task.name,
            todo="ask for fewer prompts, or give a larger vocabulary",
        )
    order = stream(seed, "irrelevant prompts").permutation(len(names))
    variants = []
    for share in IRRELEVANT_SHARES:
        chosen = order[: round(share * len(task.prompts))]
        irrelevant = tuple(names[i] for i in chosen)
        name = f"+{share:.0%} irrelevant" if share else "task only"
        variants.append(Variant(name, settings, replace(task, irrelevant=irrelevant)))
    return variants


def embedding_spaces(settings: SemanticsConfig) -> list[Variant]:
    """Table 4 and Fig. 4: what semantics are decoded from."""
    spaces = {
        "color": SemanticSpace("color", False),
        "geometry": SemanticSpace("geometry", False),
        "parametric": SemanticSpace("parametric", False),
        "coordinates": SemanticSpace("none", True),
        "color + coordinates": SemanticSpace("color", True),
        "geometry + coordinates": SemanticSpace("geometry", True),
        "parametric + coordinates": SemanticSpace("parametric", True),
    }
    return [Variant(name, replace(settings, space=space)) for name, space in spaces.items()]


def run_variants(
    reader: LogReader,
    variants: Sequence[Variant],
    perceiver_of: Callable[[Task | None], Perceiver],
    texts: TextSpace,
    config: ReplayConfig,
    progress: Callable[[int, int], None],
) -> dict[str, Outcome]:
    """Train and judge all variants in one pass.

    Args:
        reader: a log with labels and a labelled mesh.
        variants: the rows.
        perceiver_of: finds the regions for a task, or for the log's own where it is None.
        texts: where the candidates' names are looked up.
        config: of the replay; its semantic settings are those of the variants.
        progress: told the frames done and the frames in all.

    Returns:
        By the variant's name what became of it.

    Raises:
        ProgroundError: the log has no labelled mesh.
    """
    points = labelled_points_of_log(reader, texts)
    if points is None:
        raise ProgroundError(
            "has no labelled mesh to judge variants by",
            where=reader.path,
            todo="take a log with ground truth, such as that of `pglog record synthetic`",
        )
    device = choose_device(config.device)
    mapper = OnlineMapper(config.mapper, reader.recording.bounds, config.seed, device)
    perceivers = {variant.perception: perceiver_of(variant.task) for variant in variants}
    learners = {
        variant.name: SemanticLearner(
            replace(config.mapper, semantics=variant.settings),
            perceivers[variant.perception].description,
            mapper.averaged,
            config.seed,
        )
        for variant in variants
    }
    losses: dict[str, list[float]] = {variant.name: [] for variant in variants}
    register = Registration(reader.calibration)
    chosen = config.selection.of(len(reader))[: config.max_frames]
    for done, sensor in enumerate(reader.frames(chosen), start=1):
        views = {
            key: register(replace(sensor, regions=perceiver(sensor)))
            for key, perceiver in perceivers.items()
        }
        is_keyframe = (done - 1) % config.simulation.keyframe_every == 0
        mapper.insert(next(iter(views.values())), is_keyframe=is_keyframe)
        for variant in variants:
            frame = views[variant.perception]
            learners[variant.name].insert(frame, mapper.pixels)
        for iteration in range(config.steps):
            mapper.step()
            for name, learner in learners.items():
                step = learner.step(sensor.index, iteration)
                if step is not None and "semantic" in step.losses:
                    losses[name].append(step.losses["semantic"])
        progress(done, len(chosen))
    surface = extract_mesh(NeuralMap(mapper.averaged, mapper.observed), COVERAGE_VOXEL_M)
    outcomes = {}
    for name, learner in learners.items():
        semantics = SemanticMap(learner.heads, learner.description)
        content = NeuralMap(mapper.averaged, mapper.observed, semantics)
        scores = semantic_scores(content, points, texts, surface.vertices_m)
        outcomes[name] = Outcome(scores, losses[name])
    return outcomes
