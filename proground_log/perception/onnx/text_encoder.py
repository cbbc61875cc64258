"""A text encoder (CLIP) as an ONNX file: the text space that knows every text."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from proground_log.errors import ProgroundError
from proground_log.perception.onnx.session import open_session
from proground_log.perception.onnx.tokenizer import CONTEXT, tokens
from proground_log.perception.texts import of_length_1
from proground_log.regions import EMBEDDING_WIDTH

TEMPLATE = "a {}"
"""What is said about a name; vocabularies from Detic have it too."""


class OnnxTextEncoder:
    """Embeds any text with a network.

    Args:
        path: an ONNX file with `input_ids` int64 [N, 77] in and `embeddings` float32 [N, 512] out,
            of any length; N free, or 1.
        template: the sentence that a name is put into, at its "{}".

    Raises:
        ProgroundError: the file breaks this contract, or the template has no single "{}".
    """

    def __init__(self, path: Path, template: str = TEMPLATE) -> None:
        if template.count("{}") != 1:
            raise ProgroundError(
                f"the template {template!r} must have one {{}} for the name",
                where=path,
                todo=f"write it like {TEMPLATE!r}",
            )
        self._model = open_session(
            path,
            kind="text encoder",
            inputs={"input_ids": (1, CONTEXT)},
            outputs={"embeddings": (1, EMBEDDING_WIDTH)},
            int64=("input_ids",),
        )
        self._template = template
        self.origin = {
            "kind": "text encoder",
            "file": path.name,
            "sha256": self._model.sha256,
            "template": template,
        }

    def embed(self, names: Sequence[str]) -> np.ndarray:
        """Embeddings float32 [N, 512] of length 1 of names in the template.

        Raises:
            ProgroundError: a text is empty or longer than CLIP reads, or the network fails on it.
        """
        texts = [tokens(self._sentence(name)) for name in names]
        # One by one: kernels round differently in batches of another size, and so the embedding
        # of a text would depend on what else is asked.
        outputs = [self._model.run({"input_ids": text[None]})["embeddings"] for text in texts]
        nothing = np.zeros((0, EMBEDDING_WIDTH), np.float32)
        return of_length_1(np.concatenate([nothing, *outputs]), where=self._model.path)

    def _sentence(self, name: str) -> str:
        if not name.strip():
            raise ProgroundError(
                "cannot embed an empty text", where=self._model.path, todo="write some words"
            )
        return self._template.replace("{}", " ".join(name.split()))
