"""From what the heads say of a point to what it has to do with a text.

A point has one embedding, and logits for the level of the detector whose head reads it, with a
fourth for "nothing was ever learnt here" (paper, Sec. 4.2 and 5.1).
"""

from __future__ import annotations

import numpy as np
from scipy.special import softmax
from threadpoolctl import ThreadpoolController

from proground_log.mapping.neural.semantic_map import SemanticMap
from proground_log.perception.heads import TextHeads
from proground_log.regions import LEVELS

BLOCK = 1024
"""Points at once: what is computed of them stays in the processor's cache."""
BLAS = ThreadpoolController().select(user_api="blas")
"""The library behind numpy's products. With some of its kernels the last bits depend on the number
of threads, so that products whose bits count are computed on one."""


def taken_back(semantics: SemanticMap, texts: np.ndarray) -> np.ndarray:
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
    weights = level_weights(scale_logits)
    # A sum of heads is a head: weighing scales and shifts rather than logits asks for one product
    # with the texts instead of three.
    factor = np.exp(heads.logit_scale)[:, None]
    scale = (factor * heads.scale).astype(np.float32)
    offset = (factor * heads.shift @ texts.T + heads.bias[:, None]).astype(np.float32)
    logits = np.empty((len(embeddings), len(texts)), np.float32)
    with BLAS.limit(limits=1):
        for start in range(0, len(embeddings), BLOCK):
            block = slice(start, start + BLOCK)
            aligned = weights[block] @ scale
            aligned *= embeddings[block]
            np.matmul(aligned, texts.T, out=logits[block])
            logits[block] += weights[block] @ offset
    return logits


def level_weights(scale_logits: np.ndarray) -> np.ndarray:
    """How much each level of the detector counts for a point, float32 [V, 3], of [V, 4]."""
    return np.asarray(softmax(scale_logits[:, :LEVELS].astype(np.float32), axis=1))


def aligned(embeddings: np.ndarray, scale_logits: np.ndarray, heads: TextHeads) -> np.ndarray:
    """Embeddings as the texts' space has them, float32 [V, 512], of length 1.

    Args:
        embeddings: float32 [V, 512], before any head.
        scale_logits: float32 [V, 4].
        heads: the detector's.
    """
    weights = level_weights(scale_logits)
    result = np.empty((len(embeddings), embeddings.shape[1]), np.float32)
    with BLAS.limit(limits=1):
        for start in range(0, len(embeddings), BLOCK):
            block = slice(start, start + BLOCK)
            part = weights[block] @ heads.scale
            part *= embeddings[block]
            part += weights[block] @ heads.shift
            length = np.sqrt(np.einsum("nd,nd->n", part, part))
            result[block] = part / np.maximum(length, 1e-8)[:, None]
    return result


def background_probability(scale_logits: np.ndarray, uncertainty: np.ndarray) -> np.ndarray:
    """Probability [V] that nothing was learnt at a vertex: what two heads think, averaged.

    The scale head tells it by the hash features of a place, the uncertainty head by coordinates.

    Args:
        scale_logits: [V, 4]; the fourth is "no supervision".
        uncertainty: [V] in [0, 1].
    """
    return 0.5 * (softmax(scale_logits, axis=1)[:, LEVELS] + uncertainty)
