"""How things lie to each other, told from their upright boxes alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from proground_log.mapping.boxes import OrientedBox, gap_m, shared_plan_m2, shared_volume_m3

NEAR_M = 1.0
"""Things no farther apart than an arm and a step are near."""
CONTACT_M = 0.1
"""Boxes of a map touch within this: surfaces are some voxels thick, and cloth gives way."""
MOST = 0.5
"""The share of a thing that has to be over, under or in the other."""


def is_on(thing: OrientedBox, other: OrientedBox) -> bool:
    """Whether a thing rests on another.

    Most of its plan is over the other's, it is the higher one, and its underside lies between the
    middle of the other and a little above its top: a cushion on a sofa lies below the top of the
    sofa's back. What is thin, as a rug, has no lower half.
    """
    up = other.axes[2]
    least_m = min(float(other.centre_m @ up), other.top_m - CONTACT_M)
    return bool(
        _plan_share(thing, other) >= MOST
        and thing.centre_m @ up > other.centre_m @ up
        and least_m <= thing.bottom_m <= other.top_m + CONTACT_M
    )


def is_above(thing: OrientedBox, other: OrientedBox) -> bool:
    """Whether a thing is over another without touching it: most of the smaller plan of the two
    is over or under the larger."""
    smaller = max(_plan_share(thing, other), _plan_share(other, thing))
    return smaller >= MOST and thing.bottom_m > other.top_m + CONTACT_M


def is_under(thing: OrientedBox, other: OrientedBox) -> bool:
    """Whether a thing is beneath another: the other is on or above it, or most of its plan is
    within the other's, as of a bin under a desk, and its middle and top are lower."""
    is_covered = (
        _plan_share(thing, other) >= MOST
        and thing.top_m < other.top_m - CONTACT_M
        and thing.centre_m @ thing.axes[2] < other.centre_m @ other.axes[2]
    )
    return bool(is_covered) or is_on(other, thing) or is_above(other, thing)


def is_in(thing: OrientedBox, other: OrientedBox) -> bool:
    """Whether most of a thing is inside another's box, which is the larger."""
    return (
        thing.volume_m3 < other.volume_m3
        and shared_volume_m3(thing, other) >= MOST * thing.volume_m3
    )


def is_near(thing: OrientedBox, other: OrientedBox) -> bool:
    """Whether the gap between two things is small."""
    return gap_m(thing, other) <= NEAR_M


RELATIONS: Mapping[str, Callable[[OrientedBox, OrientedBox], bool]] = {
    "on": is_on,
    "under": is_under,
    "above": is_above,
    "in": is_in,
    "near": is_near,
}
"""By name: whether the first box lies so to the second."""
WORDS: Mapping[str, str] = {
    "on top of": "on",
    "on": "on",
    "underneath": "under",
    "beneath": "under",
    "below": "under",
    "under": "under",
    "above": "above",
    "over": "above",
    "inside": "in",
    "in": "in",
    "close to": "near",
    "next to": "near",
    "beside": "near",
    "near": "near",
}
"""The relation that words mean; longer words come before those that begin like them."""


def _plan_share(thing: OrientedBox, other: OrientedBox) -> float:
    """The share of a thing's plan that is within the other's, or hardly beside it."""
    reach_m = np.array([2 * CONTACT_M, 2 * CONTACT_M, 0.0])
    grown = replace(other, extent_m=other.extent_m + reach_m)
    return shared_plan_m2(thing, grown) / float(thing.extent_m[0] * thing.extent_m[1])
