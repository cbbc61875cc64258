"""Opening an ONNX file under a contract: what goes in, what comes out, and the same bits always."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnxruntime as ort
from onnxruntime.capi import onnxruntime_pybind11_state as ort_errors

from proground_log.errors import ProgroundError
from proground_log.files import require_file

Shape = tuple[int | str, ...]
"""A number is a size that must be so, a word one that is free."""

_REMEDY = "export it under the contract in docs/perception.md"
_ELEMENTS = {"tensor(float)": "float32", "tensor(int64)": "int64"}
_REFUSALS = (
    ort_errors.Fail,
    ort_errors.InvalidArgument,
    ort_errors.InvalidGraph,
    ort_errors.InvalidProtobuf,
    ort_errors.NotImplemented,
    ort_errors.RuntimeException,
)
"""What onnxruntime raises over a file or an input; they have no common class."""


@dataclass(frozen=True)
class OnnxModel:
    """A network that keeps its contract.

    Args:
        session: where it runs.
        path: its file.
        sha256: fingerprint of the file's bytes, hexadecimal.
        metadata: what its maker wrote into it, by key ("proground.contract", ...).
        outputs: shapes of the contract's outputs that it has.
    """

    session: ort.InferenceSession
    path: Path
    sha256: str
    metadata: dict[str, str]
    outputs: dict[str, Shape]

    @property
    def output_names(self) -> frozenset[str]:
        """The contract's outputs that it has."""
        return frozenset(self.outputs)

    def run(self, inputs: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The contract's outputs for these inputs, by name.

        Raises:
            ProgroundError: the network does not take an input of this size, or an output has
                another shape than the contract's.
        """
        names = sorted(self.outputs)
        try:
            outputs = dict(zip(names, self.session.run(names, dict(inputs)), strict=True))
        except _REFUSALS as error:
            raise _error(f"cannot be run ({error})", self.path) from error
        for name, output in outputs.items():
            _check_shape(f"output {name!r}", output.shape, self.outputs[name], self.path)
        return outputs


def open_session(
    path: Path,
    *,
    kind: str,
    inputs: dict[str, Shape],
    outputs: dict[str, Shape],
    optional_outputs: dict[str, Shape] = {},  # noqa: B006 -- it is only read
    int64: Collection[str] = (),
) -> OnnxModel:
    """Open an ONNX file and check that it keeps a contract.

    It runs on the CPU, in one thread: kernels that split their work among threads round
    differently with their number, so that more would make results depend on the machine. Whoever
    has cores to spare runs several images at a time.

    Args:
        path: the file. It must hold its weights itself, so that its fingerprint covers them.
        kind: what it should be ("detector", ...), for errors.
        inputs: shape by name, all that the network may ask for.
        outputs: shape by name; the network may have others, which are not computed.
        optional_outputs: shape by name of those that it may lack.
        int64: names of the tensors of type int64; the others are float32.

    Raises:
        ProgroundError: no ONNX file, or one that breaks the contract; says how.
    """
    content = require_file(path).read_bytes()
    options = ort.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    options.log_severity_level = 4  # What it would print, it raises as well.
    try:
        session = ort.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except _REFUSALS as error:
        raise _error(f"is no ONNX file that onnxruntime can load ({error})", path) from error

    found_inputs = {node.name: node for node in session.get_inputs()}
    found_outputs = {node.name: node for node in session.get_outputs()}
    for name in found_inputs:
        if name not in inputs:
            raise _error(f"asks for an input {name!r}, which no {kind} gets", path)
    kept = outputs | {n: shape for n, shape in optional_outputs.items() if n in found_outputs}
    for side, found, wanted in (("input", found_inputs, inputs), ("output", found_outputs, kept)):
        for name, shape in wanted.items():
            what = f"{side} {name!r}"
            if name not in found:
                raise _error(f"has no {what}, so it is no {kind}", path)
            element = _ELEMENTS.get(found[name].type, found[name].type)
            needed = "int64" if name in int64 else "float32"
            if element != needed:
                raise _error(f"{what} is {element}, not {needed}", path)
            _check_shape(what, found[name].shape, shape, path)
    return OnnxModel(
        session=session,
        path=path,
        sha256=hashlib.sha256(content).hexdigest(),
        metadata=dict(session.get_modelmeta().custom_metadata_map),
        outputs=kept,
    )


def _check_shape(what: str, found: Sequence[int | str | None], wanted: Shape, path: Path) -> None:
    """Sizes that the file leaves open, or that the contract does, fit."""
    fits = len(found) == len(wanted) and all(
        is_size == size
        for is_size, size in zip(found, wanted, strict=True)
        if isinstance(is_size, int) and isinstance(size, int)
    )
    if not fits:
        raise _error(f"{what} has shape {_written(found)}, not {_written(wanted)}", path)


def _written(shape: Sequence[int | str | None]) -> str:
    return f"[{', '.join('?' if size is None else str(size) for size in shape)}]"


def _error(what: str, where: Path) -> ProgroundError:
    return ProgroundError(what, where=where, todo=_REMEDY)
