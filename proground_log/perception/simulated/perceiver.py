"""A simulated prompted detector: ground-truth labels in, regions with a detector's errors out.

It stands in for YOLO-World and FastSAM where there are no weights. Its errors are those of real
ones: relevance falls with distance, occlusion, truncation and size; similar prompts are taken for
each other, and every further prompt competes (paper, Table 3); masks are ragged, bleed, split and
merge. Much of an error belongs to the thing and the side that it is seen from, so that it comes
again in the next frame and does not average out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import expit, softmax

from proground_log.camera import Camera
from proground_log.errors import ProgroundError
from proground_log.frame import SensorFrame
from proground_log.perception.builtin_texts import COMMON_SHARE, BuiltinTexts, common_direction
from proground_log.perception.description import PerceptionDescription
from proground_log.perception.heads import TextHeads
from proground_log.perception.simulated.masks import Outline, Thing, draw_outlines, find_things
from proground_log.perception.task import Task
from proground_log.regions import EMBEDDING_WIDTH, LEVELS, Regions
from proground_log.streams import stream

_CONTRAST = 20.0
"""Logits between the right prompt and one that has nothing to do with it."""
_NONE_SIMILARITY = 0.9
"""What resembles no prompt by more than this is rather taken for background."""
_EMBEDDING_CONTRAST = 8.0
"""The same as _CONTRAST, for what the embedding says to texts."""
_EMBEDDING_NOISE = 0.35
"""Length of the part of an embedding that means nothing, beside 1 for the part that does."""
_CLARITY = 2.0
"""Logit of how clearly a thing is seen that is near, whole and large."""
_CONFUSION, _NEVER_SURE = 12.0, 1.0
"""Noise on each prompt's logit: its spread is the first, times the second less the clarity."""
_PERSISTENT = 0.8
"""Share of the noise's variance that stays with a thing and the side it is seen from."""
_MOOD = 1.5
"""Spread of the noise on how clearly a thing is seen, in logits."""
_DUPLICATED, _MISSED = 0.15, 0.04
"""How often a thing is found twice, or not at all."""
_PLACE_M, _SIDE = 1.2, 0.8
"""How far a thing or the direction to it (as a unit vector) has to move for other noise."""
_WAVES = 128
"""Waves that the persistent noise is summed of."""
_UNKNOWN_DEPTH_M = 2.0


class SimulatedPerception:
    """Finds a task's prompts in frames with ground truth; equal seeds and frames, equal regions.

    Args:
        task: what to look for; the built-in texts have to know its prompts.
        label_names: class names by label; what the texts do not know is nobody's prompt either
            and passes for background.
        camera: the colour camera, whose pixels the labels are; a frame's own goes before it.
        seed: of all errors.
        strength: of all errors; 0 gives perfect labels.

    Raises:
        ProgroundError: a prompt that the built-in texts do not know; a frame without labels.
    """

    def __init__(
        self,
        task: Task,
        label_names: dict[int, str],
        camera: Camera,
        seed: int,
        strength: float = 1.0,
    ) -> None:
        texts = BuiltinTexts()
        prompts = texts.embed(task.all_prompts)
        names = {k: name for k, name in label_names.items() if k > 0 and texts.knows(name)}
        self._meanings = dict(zip(names, _meaning(texts.embed(list(names.values()))), strict=True))
        self._prompts = _meaning(prompts)
        self._camera, self._seed, self._strength = camera, seed, strength
        self._detection = task.thresholds.detection
        # Of its clarity, of passing for background, and of passing for each prompt.
        self._tendencies = _Tendencies(seed, ("clarity", "nothing", *task.all_prompts))
        self.description = PerceptionDescription(
            task=task,
            texts=prompts,
            heads=_heads(),
            origin={
                "kind": "simulated",
                "seed": str(seed),
                "strength": str(strength),
                **{f"texts.{name}": value for name, value in texts.origin.items()},
            },
        )

    def __call__(self, frame: SensorFrame) -> Regions:
        """The regions of a frame."""
        if frame.labels is None:
            raise ProgroundError(
                "has no ground-truth labels, which the simulated detector needs",
                where=f"frame {frame.index}",
                todo="choose a log with labels, or a detector file",
            )
        camera = self._camera if frame.calibration is None else frame.calibration.color
        expected = camera.height, camera.width
        if frame.labels.shape != expected:
            raise ProgroundError(
                f"the labels have shape {frame.labels.shape}, the colour camera {expected}",
                where=f"frame {frame.index}",
                todo="record the log again with the right calibration",
            )
        # Where depth has pixels of its own, a thing is as far away as most are.
        is_registered = frame.depth.shape == frame.labels.shape
        depth_m = frame.depth_m if is_registered else np.zeros(frame.labels.shape, np.float32)
        numbers, things = find_things(frame.labels, depth_m)
        found: list[tuple[Outline, _Sight]] = []
        for thing in things:
            if thing.label not in self._meanings:
                continue
            moment = frame.index, thing.number
            tendency = self._tendencies(self._place(thing, camera, frame.world_from_camera))
            outlines = self._outlines(numbers, thing, stream(self._seed, "outlines", *moment))
            for turn, outline in enumerate(outlines):
                random = stream(self._seed, "sights", *moment, turn)
                sight = self._look(thing, outline, camera.width, tendency, random)
                if sight.relevance.max() >= self._detection:
                    found.append((outline, sight))
        return _regions(found, frame.labels.shape, len(self._prompts))

    def _place(self, thing: Thing, camera: Camera, world_from_camera: np.ndarray) -> np.ndarray:
        """Where a thing is, in metres, and the direction to it, in world axes, [6]."""
        column, row = (int(value) for value in thing.centre)
        ray = world_from_camera[:3, :3] @ camera.directions[row, column]
        point_m = world_from_camera[:3, 3] + ray * (thing.depth_m or _UNKNOWN_DEPTH_M)
        return np.concatenate([point_m, ray / np.linalg.norm(ray)])

    def _outlines(
        self, numbers: np.ndarray, thing: Thing, random: np.random.Generator
    ) -> list[Outline]:
        missed, duplicated = random.random(2) < self._strength * np.array([_MISSED, _DUPLICATED])
        outlines = []
        for _ in range(0 if missed else 2 if duplicated else 1):
            outlines += draw_outlines(numbers, thing, self._strength, random)
        return outlines

    def _look(
        self,
        thing: Thing,
        outline: Outline,
        width: int,
        tendency: np.ndarray,
        random: np.random.Generator,
    ) -> _Sight:
        """What the detector makes of what it has outlined in an image of this width."""
        strength, meaning = self._strength, self._meanings[thing.label]
        level_jitter = random.standard_normal()
        aimless = _meaning(random.standard_normal(EMBEDDING_WIDTH))
        # Drawn last and prompt by prompt: a further prompt leaves the others' noise as it is.
        passing = random.standard_normal(len(tendency))
        noise = np.sqrt(_PERSISTENT) * tendency + np.sqrt(1 - _PERSISTENT) * passing
        side_px = np.sqrt(np.prod(outline.box[2:] - outline.box[:2])) * 640 / width

        clarity = expit(_CLARITY - strength * (_difficulty(thing, side_px) + _MOOD * noise[0]))
        likeness = np.append(_NONE_SIMILARITY, self._prompts @ meaning)
        belief = softmax(
            _CONTRAST * likeness + strength * _CONFUSION * (_NEVER_SURE - clarity) * noise[1:]
        )
        relevance = clarity * belief[1:].max()

        seen = belief[0] * meaning + belief[1:] @ self._prompts
        seen = seen / np.linalg.norm(seen) + strength * _EMBEDDING_NOISE * aimless
        seen /= np.linalg.norm(seen)
        level = int(np.clip(round(np.log2(side_px / 80) + strength * 0.4 * level_jitter), 0, 2))
        embedding = self._embedding(seen, relevance, level)
        heads, texts = self.description.heads, self.description.texts
        return _Sight(level, embedding, expit(heads.logits(embedding[None], level, texts))[0])

    def _embedding(self, seen: np.ndarray, relevance: float, level: int) -> np.ndarray:
        """The embedding, float16 [512], that the level's head gives this relevance.

        What is seen decides how the prompts' logits differ; how much there is of the direction
        that all texts share moves them together, until the best one is right.
        """
        heads = self.description.heads
        logit = (np.log(relevance / (1 - relevance)) - heads.bias[level]) / np.exp(
            heads.logit_scale[level]
        )
        own = seen * _EMBEDDING_CONTRAST / np.exp(heads.logit_scale[level])
        common = (logit - (self._prompts @ own).max()) / np.sqrt(COMMON_SHARE)
        aligned = common * common_direction() + own / np.sqrt(1 - COMMON_SHARE)
        return ((aligned - heads.shift[level]) / heads.scale[level]).astype(np.float16)


@dataclass(frozen=True)
class _Sight:
    """What a detector says of an outline: level, embedding float16 [512], relevance [K]."""

    level: int
    embedding: np.ndarray
    relevance: np.ndarray


class _Tendencies:
    """Smooth noise over places and directions: what a detector tends to mistake, and from where.

    A Gaussian process as a sum of waves (random Fourier features, Rahimi and Recht 2007); its
    values have mean 0 and variance 1, and each name has its own.
    """

    def __init__(self, seed: int, names: tuple[str, ...]) -> None:
        random = stream(seed, "tendencies")
        self._waves = random.standard_normal((_WAVES, 6)) / np.array([_PLACE_M] * 3 + [_SIDE] * 3)
        self._phases = random.uniform(0, 2 * np.pi, _WAVES)
        draws = [stream(seed, f"tendency/{name}").standard_normal(_WAVES) for name in names]
        self._weights = np.stack(draws) * np.sqrt(2 / _WAVES)

    def __call__(self, place: np.ndarray) -> np.ndarray:
        """Of every name [N] at a place and direction [6]."""
        return np.asarray(self._weights @ np.cos(self._waves @ place + self._phases))


def _regions(found: list[tuple[Outline, _Sight]], shape: tuple[int, ...], prompts: int) -> Regions:
    """Regions by falling relevance, with overlapping masks settled."""
    found = sorted(found, key=lambda pair: -float(pair[1].relevance.max()))
    owner = np.zeros(shape, np.uint16)
    for number, (outline, _) in reversed(list(enumerate(found, start=1))):
        height, width = outline.mask.shape
        window = owner[outline.top : outline.top + height, outline.left : outline.left + width]
        window[outline.mask] = number
    return Regions(
        boxes=np.array([o.box for o, _ in found], np.float32).reshape(-1, 4),
        levels=np.array([s.level for _, s in found], np.uint8),
        relevance=np.array([s.relevance for _, s in found], np.float32).reshape(-1, prompts),
        embeddings=np.array([s.embedding for _, s in found], np.float16).reshape(
            -1, EMBEDDING_WIDTH
        ),
        owner=owner,
        is_box=np.array([o.is_box for o, _ in found], bool),
    )


def _difficulty(thing: Thing, side_px: float) -> float:
    """What distance, a hidden or truncated outline and small size take from the logit."""
    far = 0.5 * max(thing.depth_m - 1.0, 0)
    small = 0.6 * max(np.log2(64 / max(side_px, 1)), 0)
    return far + small + 2.5 * thing.hidden + 1.5 * thing.truncated


def _heads() -> TextHeads:
    """Three heads that differ, as a detector's do; the same for all seeds."""
    random = stream(0, "simulated heads")
    size = np.array([[0.8], [1.0], [1.3]])
    return TextHeads(
        scale=(size * np.exp(random.normal(0, 0.4, (LEVELS, EMBEDDING_WIDTH)))).astype(np.float32),
        shift=random.normal(0, 0.3, (LEVELS, EMBEDDING_WIDTH)).astype(np.float32),
        logit_scale=np.array([-0.1, 0.0, 0.1], np.float32),
        bias=np.array([-6.5, -6.0, -5.5], np.float32),
    )


def _meaning(vectors: np.ndarray) -> np.ndarray:
    """The part of texts or noise [..., 512] that is not common to all, made of length 1."""
    vectors = np.asarray(vectors, np.float64)
    common = common_direction()
    own = vectors - (vectors @ common)[..., None] * common
    return np.asarray(own / np.linalg.norm(own, axis=-1, keepdims=True))
