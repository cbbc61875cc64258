"""From what a map says of its vertices to what they have to do with a text or an image."""

from __future__ import annotations

import numpy as np
from scipy.special import expit

from proground_log.mapping.map import BACKGROUND

MARGIN = 2.0
"""How far below the best text a query may stay on a vertex and still claim it, in logits.

Measured with a real detector on kitchen and house: other names of one thing (armchair for a chair,
mug for a cup, kitchen table for a dining table) lie 0.3 to 1.8 below its prompt, other things of
its kind (stool for a chair, wine glass for a cup, sofa for a bed) from 2.1 on.
"""


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
        background: [V], how likely each is background.
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
