"""What people ask, taken apart."""

from __future__ import annotations

import pytest

from proground_log.errors import ProgroundError
from proground_log.query.parse import Query, parse_query


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("chair", Query("chair")),
        ("  A  Chair ", Query("chair")),
        ("red chair", Query("chair", "red")),
        ("the gray dining chair", Query("dining chair", "grey")),
        ("orange", Query("orange")),
        ("chair, not sofa", Query("chair", without=("sofa",))),
        ("chair, not a sofa, not stool", Query("chair", without=("sofa", "stool"))),
        ("lemon, not orange, not red ball", Query("lemon", without=("orange", "red ball"))),
        ("cup on table", Query("cup", relation="on", other=Query("table"))),
        ("cup on top of the table", Query("cup", relation="on", other=Query("table"))),
        ("chair next to sink", Query("chair", relation="near", other=Query("sink"))),
        ("bin underneath desk", Query("bin", relation="under", other=Query("desk"))),
        (
            "a red cup, not mug, on white table, not desk",
            Query("cup", "red", ("mug",), "on", Query("table", "white", ("desk",))),
        ),
        (
            "cup on table near sofa",
            Query("cup", None, (), "on", Query("table", None, (), "near", Query("sofa"))),
        ),
        ("built-in oven", Query("built-in oven")),
        ("onion in bowl", Query("onion", relation="in", other=Query("bowl"))),
    ],
)
def test_questions_are_taken_apart(text: str, expected: Query) -> None:
    assert parse_query(text) == expected


def test_a_known_name_is_one_word_whatever_it_says() -> None:
    known = ("white board", "picture on wall", "red chair")
    assert parse_query("White board", known) == Query("white board")
    assert parse_query("a red chair", known) == Query("red chair")
    assert parse_query("picture on wall", known) == Query("picture on wall")
    assert parse_query("cup near picture on wall", known) == Query(
        "cup", relation="near", other=Query("picture on wall")
    )
    assert parse_query("black picture on wall", known) == Query("picture on wall", "black")
    assert parse_query("red", ("red",)) == Query("red")
    assert parse_query("chair, not red", ("red",)) == Query("chair", without=("red",))
    assert parse_query("white board", ()) == Query("board", "white")


def test_the_names_of_a_question_are_all_that_need_an_embedding() -> None:
    query = parse_query("red cup, not mug, on table near sofa")
    assert query.names == ("cup", "mug", "table", "sofa")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (" ", "empty"),
        ("on table", "names no thing"),
        ("cup on", "names no thing"),
        ("not sofa", "names no thing"),
        ("chair, sofa", "only 'not' can be"),
        ("chair, not the", "names no thing"),
        ("chair, not red", "says 'red' after 'not', where only a thing can be"),
        ("cup on table, not sofa, not a gray", "says 'gray' after 'not'"),
        ("the", "names no thing"),
        ("red", "query 'red': a colour needs a thing; say of what, as in \"red chair\""),
        ("a Grey", "a colour needs a thing"),
        ("cup on the white", "a colour needs a thing"),
    ],
)
def test_what_cannot_be_read_is_refused(text: str, message: str) -> None:
    with pytest.raises(ProgroundError, match=message):
        parse_query(text)
