from __future__ import annotations

from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest

from proground_log.errors import ProgroundError
from recorders.reading.json_file import numbers, parse_json, read_json


def test_numbers_stay_as_they_were_written(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text('{"t": 1305031229.528784123, "n": 3}')
    assert read_json(tmp_path / "a.json") == {"t": Decimal("1305031229.528784123"), "n": 3}


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, "1e99999999999999999999", "9" * 5000])
def test_what_is_no_json_is_named(text: str) -> None:
    with pytest.raises(ProgroundError, match=r"a\.json: is not JSON"):
        parse_json(text, where="a.json")


def test_numbers_have_a_shape() -> None:
    value = parse_json("[[1, 2.5], [null, NaN]]", where="a")
    found = numbers(value, (2, 2), what="pose", where="a")
    np.testing.assert_array_equal(found, [[1, 2.5], [np.nan, np.nan]])
    assert found.dtype == np.float64
    assert numbers(value, (-1, 4), what="pose", where="a").shape == (1, 4)


@pytest.mark.parametrize("text", ["null", "[1]", '["x", 1]', "[[1], 2]", "{}", f"[1, {10**400}]"])
def test_other_than_numbers_is_named(text: str) -> None:
    value = parse_json(text, where="a.json")
    with pytest.raises(ProgroundError, match=r"a\.json: pose is not 1 x 2 numbers"):
        numbers(value, (1, 2), what="pose", where="a.json")
