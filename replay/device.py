"""The device that a replay computes on, and what makes it repeatable there."""

from __future__ import annotations

import os

import numba
import torch

from proground_log.errors import ProgroundError


def choose_device(wanted: str) -> str:
    """Turn auto, cpu or cuda into cpu or cuda, and make torch deterministic on it."""
    if wanted not in ("auto", "cpu", "cuda"):
        raise ProgroundError(
            f"there is no device {wanted!r}", where="--device", todo="use auto, cpu or cuda"
        )
    available = torch.cuda.is_available()
    if wanted == "cuda" and not available:
        raise ProgroundError(
            "torch sees no CUDA device here",
            where="--device cuda",
            todo="use --device cpu, or install a CUDA build of torch",
        )
    device = "cuda" if available and wanted != "cpu" else "cpu"
    if device == "cuda":
        # cuBLAS repeats itself only with a fixed workspace.
        os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    torch.use_deterministic_algorithms(True)
    # Nothing here reads memory that was not written; filling it first costs time.
    torch.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]
    return device


def set_threads(threads: int | None) -> None:
    """Compute on so many threads; the result is the same for any number."""
    if threads is None:
        return
    if threads < 1:
        raise ProgroundError(
            f"{threads} threads cannot compute", where="--threads", todo="use 1 or more"
        )
    torch.set_num_threads(threads)
    numba.set_num_threads(min(threads, numba.get_num_threads()))
