from __future__ import annotations

from recorders.reading.natural_order import natural_key


def test_numbers_count_as_numbers() -> None:
    names = ["b/2.jpg", "b/1_10.jpg", "b/1_9.jpg", "b/1.jpg", "a/10.jpg", "a/9.jpg"]
    assert sorted(names, key=natural_key) == names[::-1]


def test_leading_zeros_decide_last() -> None:
    assert sorted(["a9b", "a09", "a9"], key=natural_key) == ["a09", "a9", "a9b"]


def test_a_number_may_have_any_length() -> None:
    assert natural_key("9" * 5000) < natural_key("1" + "0" * 5000)
