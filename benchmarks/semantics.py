"""What meaning costs: a step with semantics, and perception, against what lies beneath them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.rows import SHARED_DATA, Row, median_seconds
from benchmarks.step import BOUNDS, FRAMES, PUBLISHED, STEPS_BEFORE
from proground_log.frame import SensorFrame
from proground_log.log.registration import Registration
from proground_log.mapping.neural.config import NeuralConfig
from proground_log.mapping.neural.online_mapper import OnlineMapper
from proground_log.perception.builtin_texts import BuiltinTexts
from proground_log.perception.onnx.detector import Detector
from proground_log.perception.onnx.letterbox import Letterbox
from proground_log.perception.onnx.perceiver import OnnxPerception
from proground_log.perception.onnx.session import OnnxModel
from proground_log.perception.onnx.yolo import input_side
from proground_log.perception.simulated.perceiver import SimulatedPerception
from proground_log.perception.task import Task
from proground_log.perception.vocabulary import Vocabulary
from recorders.formats.seven_scenes import SevenScenesSource
from recorders.room import RoomSource
from replay.device import choose_device

IMAGES = 8


def mapper_in_the_room(*, with_semantics: bool) -> OnlineMapper:
    """A mapper that has seen a few perceived frames of the built-in room."""
    source = RoomSource(frames=FRAMES)
    texts = BuiltinTexts()
    prompts = tuple(
        dict.fromkeys(name for name in source.label_names.values() if texts.knows(name))
    )
    perceiver = SimulatedPerception(
        Task("room", prompts), source.label_names, source.calibration.color, 0
    )
    config = replace(NeuralConfig(), sampling=PUBLISHED)
    description = perceiver.description if with_semantics else None
    mapper = OnlineMapper(config, BOUNDS, 0, "cpu", description)
    register = Registration(source.calibration)
    for index in range(FRAMES):
        sensor = source.frame(index)
        mapper.insert(register(replace(sensor, regions=perceiver(sensor))))
        for _ in range(STEPS_BEFORE):
            mapper.step()
    return mapper


def measure_step() -> list[Row]:
    """A step with semantics against one of geometry and colour alone."""
    choose_device("cpu")
    plain = mapper_in_the_room(with_semantics=False)
    semantic = mapper_in_the_room(with_semantics=True)
    plain_s, semantic_s = median_seconds(plain.step, semantic.step, rounds=25)
    return [
        Row("step without semantics", 1e3 * plain_s, "ms"),
        Row("step with semantics", 1e3 * semantic_s, "ms"),
        Row("with semantics / without", semantic_s / plain_s, "x", most=1.4),
    ]


def measure_perception() -> list[Row]:
    """Perception of real images against onnxruntime alone on the same model and images."""
    models = SHARED_DATA.parent / "models"
    scene = SHARED_DATA / "7scenes_redkitchen" / "seq-01"
    if not models.is_dir() or not scene.is_dir():
        return []
    source = SevenScenesSource(scene)
    task = Task("kitchen", ("chair", "cup", "television", "dining table"))
    texts = Vocabulary(models / "clip-vit-b32-vocabulary.npz")
    path = models / "yolov8n-seg-conse.onnx"
    perceiver, model = OnnxPerception(task, texts, path), Detector(path).model
    frames = [source.frame(30 * number) for number in range(IMAGES)]
    inputs = [_inputs(model, perceiver.description.texts, frame) for frame in frames]
    alone_s, whole_s = median_seconds(
        lambda: _run(model, inputs), lambda: [perceiver(frame) for frame in frames], rounds=5
    )
    return [
        Row("onnxruntime alone, an image", 1e3 * alone_s / IMAGES, "ms"),
        Row("perception, an image", 1e3 * whole_s / IMAGES, "ms"),
        Row("perception / onnxruntime", whole_s / alone_s, "x", most=1.3),
    ]


def _inputs(model: OnnxModel, texts: np.ndarray, frame: SensorFrame) -> dict[str, np.ndarray]:
    color = frame.decode_color()
    letterbox = Letterbox(color.shape[1], color.shape[0], input_side(model))
    return {"images": letterbox.apply(color), "text": texts}


def _run(model: OnnxModel, inputs: list[dict[str, np.ndarray]]) -> None:
    for one in inputs:
        model.session.run(None, one)
