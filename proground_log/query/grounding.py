"""From what a map knows of its vertices to what they have to do with a text or an image.

A vertex has one embedding, and logits for the level of the detector whose head reads it, with a
fourth for "nothing was ever learnt here" (paper, Sec. 4.2 and 5.1).
"""

from __future__ import annotations

import numpy as np
from scipy.special import expit, softmax

from proground_log.perception.heads import TextHeads
from proground_log.regions import LEVELS

BACKGROUND = 0.5
"""A vertex that lacks supervision with at least this probability is background."""
MARGIN = 2.0
"""How far below the best text a query may stay on a vertex and still claim it, in logits.

Measured with a real detector on kitchen and house: other names of one thing (armchair for a chair,
mug for a cup, kitchen table for a dining table) lie 0.3 to 1.8 below its prompt, other things of
its kind (stool for a chair, wine glass for a cup, sofa for a bed) from 2.1 on.
"""
_BLOCK = 1024
"""Vertices at once: their embeddings stay in the processor's cache."""


def vertex_logits(
    embeddings: np.ndarray, scale_logits: np.ndarray, heads: TextHeads, texts: np.ndarray
) -> np.ndarray:
    """Logits of every vertex for every text: sum_k p_k logit_k(t) over the levels k.

    Args:
        embeddings: float32 [V, 512], before any head.
        scale_logits: float32 [V, 4]; p is the softmax over the first three, the levels.
        heads: the detector's.
        texts: float32 [K, 512], of length 1.

    Returns:
        float32 [V, K]. Paper, Sec. 5.1.
    """
    weights = softmax(scale_logits[:, :LEVELS].astype(np.float32), axis=1)
    # A sum of heads is a head: weighing scales and shifts rather than logits asks for one product
    # with the texts instead of three.
    factor = np.exp(heads.logit_scale)[:, None]
    scale = (factor * heads.scale).astype(np.float32)
    offset = (factor * heads.shift @ texts.T + heads.bias[:, None]).astype(np.float32)
    logits = np.empty((len(embeddings), len(texts)), np.float32)
    for start in range(0, len(embeddings), _BLOCK):
        block = slice(start, start + _BLOCK)
        aligned = weights[block] @ scale
        aligned *= embeddings[block]
        np.matmul(aligned, texts.T, out=logits[block])
        logits[block] += weights[block] @ offset
    return logits


def background_probability(scale_logits: np.ndarray, uncertainty: np.ndarray) -> np.ndarray:
    """Probability [V] that nothing was learnt at a vertex: what two heads think, averaged.

    The scale head tells it by the hash features of a place, the uncertainty head by coordinates.

    Args:
        scale_logits: [V, 4]; the fourth is "no supervision".
        uncertainty: [V] in [0, 1].
    """
    return 0.5 * (softmax(scale_logits, axis=1)[:, LEVELS] + uncertainty)


def relevance_to(
    query: int, logits: np.ndarray, background: np.ndarray, *, margin: float = MARGIN
) -> np.ndarray:
    """Relevance of vertices to one text, that of the detector, where no other text fits better.

    The logit alone will not do: a sofa has some relevance to "bed" wherever it stands. So the
    query has to come close to the best of all texts, the task's prompts among them, and the
    vertex must not be background. It need not win, since "armchair" is to find what the prompt
    "chair" found.

    Args:
        query: column of the text that is asked for.
        logits: [V, K] of `vertex_logits`, for the query and the texts it competes with.
        background: [V] of `background_probability`.
        margin: how far the query may stay below the best text, in logits.

    Returns:
        float32 [V] in [0, 1]: sigmoid of the query's logit, 0 where it has no claim.
    """
    asked = logits[:, query]
    claimed = (asked >= logits.max(axis=1) - margin) & (background < BACKGROUND)
    return np.where(claimed, expit(asked), 0).astype(np.float32)


def z_scores(logits_of_query: np.ndarray, logits_of_bank: np.ndarray) -> np.ndarray:
    """By how many standard deviations vertices prefer a query to a bank of backgrounds.

    An embedded image lies apart from all texts, which shifts its logits by an amount of each
    vertex's own; a bank of embedded images is shifted alike, so that the difference counts.

    Args:
        logits_of_query: [V], of the image.
        logits_of_bank: [V, B], of B embeddings of the same kind that show nothing in particular.

    Returns:
        float32 [V]; 0 where all of the bank agree, so that there is no measure.
    """
    mean = logits_of_bank.mean(axis=1, dtype=np.float64)
    spread = logits_of_bank.std(axis=1, dtype=np.float64)
    scores = np.zeros(len(mean))
    np.divide(logits_of_query - mean, spread, out=scores, where=spread > 0)
    return scores.astype(np.float32)
