"""From what a map knows of its vertices to what they have to do with a text or an image.

A vertex has one embedding, and logits for the level of the detector whose head reads it, with a
fourth for "nothing was ever learnt here" (paper, Sec. 4.2 and 5.1).
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.special import expit, softmax
from threadpoolctl import ThreadpoolController

from proground_log.mapping.map_file import NeuralMap
from proground_log.mapping.semantic_map import SemanticMap
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
"""Vertices at once: what is computed of them stays in the processor's cache."""
_BLAS = ThreadpoolController().select(user_api="blas")
"""The library behind numpy's products. With some of its kernels the last bits depend on the number
of threads, so that products whose bits count are computed on one."""


@torch.no_grad()
def ask_map(
    content: NeuralMap, points_m: np.ndarray, texts: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What a map says of texts at points: `vertex_logits` without ever making an embedding.

    The semantic head and those of the detector are linear, so texts can be taken back through them
    to the features of the field: 80 numbers a point take the place of 512.

    Args:
        content: a map with semantics.
        points_m: [N, 3], world metres.
        texts: float32 [K, 512], of length 1.

    Returns:
        Logits, float32 [N, K], and `background_probability`, float32 [N].
    """
    semantics = content.semantics
    assert semantics is not None
    taken_back = _taken_back(semantics, texts)
    logits = np.empty((len(points_m), len(texts)), np.float32)
    background = []
    start = 0
    for features in content.features_at(points_m):
        scale_logits = semantics.heads.scale_logits(features).cpu().numpy()
        uncertainty = semantics.heads.uncertainty_logits(features).sigmoid().cpu().numpy()
        background.append(background_probability(scale_logits, uncertainty))
        weights = softmax(scale_logits[:, :LEVELS], axis=1)[:, :, None]
        ones = np.ones((len(weights), 1), np.float32)
        codes = np.concatenate([features.space.cpu().numpy(), ones], axis=1)[:, None]
        for first in range(0, len(codes), _BLOCK):
            block = slice(first, first + _BLOCK)
            # Side by side the codes times the weight of each level: the product with the texts
            # adds up the levels as well.
            weighed = (weights[block] * codes[block]).reshape(-1, len(taken_back))
            with _BLAS.limit(limits=1):
                np.matmul(weighed, taken_back, out=logits[start : start + len(weighed)])
            start += len(weighed)
    return logits, np.concatenate(background)


def _taken_back(semantics: SemanticMap, texts: np.ndarray) -> np.ndarray:
    """Texts [K, 512] as the field's features have them, float32 [3 (C + 1), K].

    For each level what its logits make of the C features, then what they add to that: with the
    semantic head W x + b, exp(logit_scale) W^T (scale t), and
    exp(logit_scale) <scale b + shift, t> + bias.
    """
    heads = semantics.description.heads
    weight = semantics.heads.semantic.detach().cpu().numpy().astype(np.float64)
    bias = semantics.heads.semantic_bias.detach().cpu().numpy().astype(np.float64)
    parts = []
    for level in range(LEVELS):
        scaled = np.exp(np.float64(heads.logit_scale[level])) * texts.T.astype(np.float64)
        of_features = (weight.T * heads.scale[level]) @ scaled
        constant = (heads.scale[level] * bias + heads.shift[level]) @ scaled + heads.bias[level]
        parts += [of_features, constant[None]]
    return np.concatenate(parts).astype(np.float32)


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
    with _BLAS.limit(limits=1):
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
    asked: np.ndarray, best: np.ndarray, background: np.ndarray, *, margin: float = MARGIN
) -> np.ndarray:
    """Relevance of vertices to one text, that of the detector, where no other text fits better.

    The logit alone will not do: a sofa has some relevance to "bed" wherever it stands. So the
    query has to come close to the best of all texts, the task's prompts among them, and the
    vertex must not be background. It need not win, since "armchair" is to find what the prompt
    "chair" found.

    Args:
        asked: [V], logits of the text that is asked for.
        best: [V], of the best of the texts that it competes with; it may be one of these.
        background: [V] of `background_probability`.
        margin: how far the query may stay below the best text, in logits.

    Returns:
        float32 [V] in [0, 1]: sigmoid of the query's logit, 0 where it has no claim.
    """
    claimed = (asked >= best - margin) & (background < BACKGROUND)
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
