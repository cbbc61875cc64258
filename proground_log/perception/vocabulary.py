"""A vocabulary: text embeddings computed once, so that a replay needs no text encoder."""

from __future__ import annotations

import hashlib
import io
import zipfile
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from proground_log.errors import ProgroundError
from proground_log.files import require_file, written_whole
from proground_log.perception.texts import NameIndex, TextSpace, of_length_1
from proground_log.regions import EMBEDDING_WIDTH

LENGTH_TOLERANCE = 1e-3
"""Twice what rounding to float16 can change of a length of 1."""
_REMEDY = "see docs/perception.md"


class Vocabulary:
    """The text space of a vocabulary file: it knows the names in it and no others.

    Args:
        path: an .npz file with `names` [V] str and `embeddings` float16 [V, 512] of length 1.

    Raises:
        ProgroundError: the file is no vocabulary; says what is wrong with it.
    """

    def __init__(self, path: Path) -> None:
        content = require_file(path).read_bytes()
        names, embeddings = _arrays(content, path)
        self._index = _checked(names, embeddings, path)
        self.names: tuple[str, ...] = tuple(names.tolist())
        self.embeddings = of_length_1(embeddings, path)
        """Float32 [V, 512] of length 1, by name."""
        self.origin = {
            "kind": "vocabulary",
            "file": path.name,
            "sha256": hashlib.sha256(content).hexdigest(),
        }

    def embed(self, names: Sequence[str]) -> np.ndarray:
        """Embeddings float32 [N, 512] of length 1.

        Raises:
            ProgroundError: a name is not in the vocabulary; names the nearest that are.
        """
        rows = np.array([self._index.row(name) for name in names], np.int64)
        return self.embeddings[rows]


def write_vocabulary(path: Path, names: Sequence[str], embeddings: np.ndarray) -> None:
    """Write a vocabulary file; equal content gives equal bytes.

    Args:
        path: replaced if it is there.
        names: V of them, none twice.
        embeddings: floats [V, 512] of length 1.

    Raises:
        ProgroundError: the content is no vocabulary, or the disk refuses it.
    """
    arrays = {"names": np.array(names, np.str_), "embeddings": embeddings.astype(np.float16)}
    _checked(arrays["names"], arrays["embeddings"], path)
    # A file and not a name, to which numpy would add an ending. No compression: its bytes
    # depend on the version of zlib.
    with written_whole(path) as temporary, temporary.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def build_vocabulary(
    names_file: Path,
    texts: TextSpace,
    output: Path,
    progress: Callable[[int, int], None],
) -> None:
    """Embed a list of names and write them as a vocabulary.

    Args:
        names_file: UTF-8 text, one name a line; '#' starts a comment.
        texts: embeds them.
        output: the vocabulary file, replaced if it is there.
        progress: told the names embedded and the names in all.

    Raises:
        ProgroundError: the list is empty or has a name twice, or a name cannot be embedded.
    """
    try:
        lines = require_file(names_file).read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ProgroundError(
            f"is no UTF-8 text ({error})", where=names_file, todo="save it as UTF-8"
        ) from error
    names = [" ".join(line.partition("#")[0].split()) for line in lines]
    names = [name for name in names if name]
    if not names:
        raise ProgroundError("has no names", where=names_file, todo="write one name a line")
    NameIndex(names, names_file)
    progress(0, len(names))
    embeddings = np.zeros((len(names), EMBEDDING_WIDTH), np.float32)
    for row, name in enumerate(names):
        embeddings[row] = texts.embed([name])[0]
        progress(row + 1, len(names))
    write_vocabulary(output, names, embeddings)


def _arrays(content: bytes, path: Path) -> tuple[np.ndarray, np.ndarray]:
    try:
        # Before numpy looks, whose reader fails in many ways on what is damaged.
        damaged = zipfile.ZipFile(io.BytesIO(content)).testzip()
        if damaged is not None:
            raise _fault(f"is damaged in {damaged!r}", path)
        archive = np.load(io.BytesIO(content), allow_pickle=False)
        for name in ("names", "embeddings"):
            if name not in archive.files:
                raise _fault(f"has no array {name!r}", path)
        return archive["names"], archive["embeddings"]
    except (ValueError, EOFError, OSError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        raise _fault(f"is no .npz file of plain arrays ({error})", path) from error


def _checked(names: np.ndarray, embeddings: np.ndarray, path: Path) -> NameIndex:
    """The index of the names of a vocabulary that keeps its contract."""
    if names.ndim != 1 or names.dtype.kind != "U":
        raise _fault(f"names are {names.dtype} {list(names.shape)}, not str [V]", path)
    if embeddings.dtype != np.float16:
        raise _fault(f"embeddings are {embeddings.dtype}, not float16", path)
    if embeddings.ndim != 2 or embeddings.shape[1] != EMBEDDING_WIDTH:
        shape = list(embeddings.shape)
        raise _fault(f"embeddings have shape {shape}, not [V, {EMBEDDING_WIDTH}]", path)
    if len(names) != len(embeddings):
        raise _fault(f"has {len(names)} names and {len(embeddings)} embeddings", path)
    if not len(names):
        raise _fault("has no names", path)
    index = NameIndex(names.tolist(), path)
    lengths = np.linalg.norm(embeddings.astype(np.float32), axis=1)
    wrong = ~(np.abs(lengths - 1) <= LENGTH_TOLERANCE)
    if wrong.any():
        row = int(wrong.argmax())
        raise _fault(
            f"the embedding of {str(names[row])!r} has length {lengths[row]:.3f}, not 1", path
        )
    return index


def _fault(what: str, path: Path) -> ProgroundError:
    return ProgroundError(what, where=path, todo=_REMEDY)
