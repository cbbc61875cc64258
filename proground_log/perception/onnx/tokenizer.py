"""CLIP's tokenizer: a text as the numbers that its text encoder reads."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from proground_log.errors import ProgroundError

if TYPE_CHECKING:
    from instant_clip_tokenizer import Tokenizer

CONTEXT = 77
"""Tokens that the encoder reads, start and end among them."""
START, END = 49406, 49407


def tokens(text: str) -> np.ndarray:
    """A text in lower case as CLIP's byte-pair tokens, int64 [77].

    It begins with `START`, ends with `END`, and is padded with 0, as in CLIP itself: the encoder
    looks at nothing behind the end.

    Raises:
        ProgroundError: the text is too long, or the tokenizer is not installed.
    """
    encoded = _tokenizer().encode(text)
    if len(encoded) > CONTEXT - 2:
        raise ProgroundError(
            f"the text has {len(encoded)} tokens, and CLIP reads at most {CONTEXT - 2}",
            where=repr(text),
            todo="shorten it",
        )
    padded = np.zeros(CONTEXT, np.int64)
    padded[: len(encoded) + 2] = START, *encoded, END
    return padded


@cache
def _tokenizer() -> Tokenizer:
    # Imported late: only a text encoder needs it, and not every machine has a build of it.
    try:
        from instant_clip_tokenizer import Tokenizer
    except ImportError as error:
        raise ProgroundError(
            "needs the package instant-clip-tokenizer",
            where="the text encoder",
            todo="run `pip install 'proground-log[text-encoder]'`, or use a vocabulary file",
        ) from error
    return Tokenizer()
