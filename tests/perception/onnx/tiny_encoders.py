"""ONNX encoders of one layer, small enough to compute by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

WIDTH = 512


def write_text_encoder(
    path: Path,
    *,
    name: str = "input_ids",
    element: int = TensorProto.INT64,
    batch: int | str = "N",
    context: int = 77,
    width: int = WIDTH,
    output: str = "embeddings",
    weights: np.ndarray | None = None,
) -> np.ndarray:
    """Write embeddings = tokens @ weights, and return the weights, float32 [77, 512]."""
    if weights is None:
        weights = np.random.default_rng(0).normal(size=(context, width)).astype(np.float32)
    nodes = [
        helper.make_node("Cast", [name], ["floats"], to=TensorProto.FLOAT),
        helper.make_node("MatMul", ["floats", "weights"], [output]),
    ]
    graph = helper.make_graph(
        nodes,
        "text",
        [helper.make_tensor_value_info(name, element, [batch, context])],
        [helper.make_tensor_value_info(output, TensorProto.FLOAT, [batch, width])],
        [numpy_helper.from_array(weights, "weights")],
    )
    _save(graph, path)
    return weights


def write_image_encoder(path: Path, *, side: int = 224) -> np.ndarray:
    """Write embeddings = the mean of each channel @ weights, and return the weights [3, 512]."""
    weights = np.random.default_rng(1).normal(size=(3, WIDTH)).astype(np.float32)
    nodes = [
        helper.make_node("ReduceMean", ["pixel_values"], ["means"], axes=[2, 3], keepdims=0),
        helper.make_node("MatMul", ["means", "weights"], ["embeddings"]),
    ]
    graph = helper.make_graph(
        nodes,
        "image",
        [helper.make_tensor_value_info("pixel_values", TensorProto.FLOAT, ["N", 3, side, side])],
        [helper.make_tensor_value_info("embeddings", TensorProto.FLOAT, ["N", WIDTH])],
        [numpy_helper.from_array(weights, "weights")],
    )
    _save(graph, path)
    return weights


def _save(graph: onnx.GraphProto, path: Path) -> None:
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    helper.set_model_props(model, {"proground.contract": "1"})
    onnx.save(model, path)
