"""ONNX detectors and segmenters that find whatever they are told to."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

WIDTH = 512
SIDE = 64
LEVELS = np.repeat(np.arange(3), [64, 16, 4])
ANCHORS = len(LEVELS)


@dataclass
class TinyDetector:
    """A detector that keeps the contract: change a part, then write it.

    It has a box for each anchor, all of the same small size, in the same place on each level.
    """

    boxes: np.ndarray = field(default_factory=lambda: tiny_boxes())
    embeddings: np.ndarray = field(default_factory=lambda: _random(0, ANCHORS, WIDTH))
    scale: np.ndarray = field(default_factory=lambda: 1 + _random(1, 3, WIDTH) / 4)
    shift: np.ndarray = field(default_factory=lambda: _random(2, 3, WIDTH) / 4)
    logit_scale: np.ndarray = field(default_factory=lambda: np.float32([0.5, -0.3, 0.1]))
    bias: np.ndarray = field(default_factory=lambda: np.float32([-1, -2, 0.5]))
    coefficients: np.ndarray = field(default_factory=lambda: _random(3, ANCHORS, 32))
    prototypes: np.ndarray = field(default_factory=lambda: _random(4, 32, SIDE // 4, SIDE // 4))
    true_bias: np.ndarray | None = None
    """What the logits are made with, where it is not the bias that is given out."""
    side: int | str = SIDE
    metadata: dict[str, str] = field(default_factory=lambda: {"proground.contract": "1"})
    without: tuple[str, ...] = ("mask_coefficients", "mask_prototypes")

    def write(self, path: Path) -> Path:
        """Write the ONNX file."""
        bias = self.bias if self.true_bias is None else self.true_bias
        outputs = {
            "boxes": self.boxes,
            "embeddings": self.embeddings,
            "head_scale": self.scale,
            "head_shift": self.shift,
            "head_logit_scale": self.logit_scale,
            "head_bias": self.bias,
            "mask_coefficients": self.coefficients,
            "mask_prototypes": self.prototypes,
        }
        gain = np.exp(self.logit_scale)[LEVELS, None]
        hidden = {
            "_aligned": (self.embeddings * self.scale[LEVELS] + self.shift[LEVELS]) * gain
            if self.embeddings.shape == (ANCHORS, WIDTH)
            else np.zeros((ANCHORS, WIDTH)),
            "_bias": bias[LEVELS, None],
        }
        nodes = [
            helper.make_node("Transpose", ["text"], ["_columns"], perm=[1, 0]),
            helper.make_node("MatMul", ["_aligned", "_columns"], ["_products"]),
            helper.make_node("Add", ["_products", "_bias"], ["logits"]),
        ]
        values = [helper.make_tensor_value_info("logits", TensorProto.FLOAT, [ANCHORS, "K"])]
        inputs = {"images": [1, 3, self.side, self.side], "text": ["K", WIDTH]}
        return _write(path, inputs, outputs, hidden, nodes, values, self.without, self.metadata)


def write_segmenter(
    path: Path,
    *,
    boxes: np.ndarray,
    scores: np.ndarray,
    coefficients: np.ndarray,
    prototypes: np.ndarray,
    without: tuple[str, ...] = (),
    side: int = SIDE,
) -> Path:
    """Write a segmenter that finds these masks in every image."""
    outputs = {
        "boxes": boxes,
        "scores": scores,
        "mask_coefficients": coefficients,
        "mask_prototypes": prototypes,
    }
    return _write(path, {"images": [1, 3, side, side]}, outputs, {}, [], [], without, {})


def tiny_boxes() -> np.ndarray:
    """A box of 6 x 6 pixels for each anchor, float32 [A, 4], none over another of its level."""
    corners = [
        np.stack(np.meshgrid(np.arange(n), np.arange(n)), -1).reshape(-1, 2) * (SIDE / n) + 1
        for n in (8, 4, 2)
    ]
    low = np.concatenate(corners)
    return np.concatenate([low, low + 6], axis=1).astype(np.float32)


def _random(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def _write(
    path: Path,
    inputs: dict[str, list[int | str]],
    outputs: dict[str, np.ndarray],
    hidden: dict[str, np.ndarray],
    nodes: list[onnx.NodeProto],
    values: list[onnx.ValueInfoProto],
    without: tuple[str, ...],
    metadata: dict[str, str],
) -> Path:
    kept = {name: value for name, value in outputs.items() if name not in without}
    constants = {f"_{name}": value for name, value in kept.items()} | hidden
    graph = helper.make_graph(
        nodes + [helper.make_node("Identity", [f"_{name}"], [name]) for name in kept],
        "tiny",
        [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in inputs.items()],
        [v for v in values if v.name not in without]
        + [helper.make_tensor_value_info(n, TensorProto.FLOAT, v.shape) for n, v in kept.items()],
        [numpy_helper.from_array(v.astype(np.float32), n) for n, v in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    helper.set_model_props(model, metadata)
    onnx.save(model, path)
    return path
