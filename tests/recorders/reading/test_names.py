from __future__ import annotations

import pytest

from recorders.reading.names import is_inside


@pytest.mark.parametrize("name", ["a.png", "rgb/1.5.png", "./rgb/ü x.png", "..a", "x" * 255])
def test_names_within_the_folder(name: str) -> None:
    assert is_inside(name)


@pytest.mark.parametrize(
    "name",
    ["", ".", "/a.png", "../a.png", "rgb/../../a.png", "a\0.png", "ü" * 128, "a/" * 2000 + "a"],
)
def test_names_that_lead_out_or_are_none(name: str) -> None:
    assert not is_inside(name)
