"""The built-in text space: synonyms, families, and words that it does not know."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from proground_log.errors import ProgroundError
from proground_log.perception.builtin_texts import _TABLE, BuiltinTexts, common_direction
from recorders.room.scene import CLASSES

TEXTS = BuiltinTexts()
LINES = [line.split(", ") for lines in _TABLE.values() for line in lines]
NAMES = [name for line in LINES for name in line]


def test_no_name_stands_for_two_things_and_each_thing_has_a_synonym() -> None:
    assert len(NAMES) == len(set(NAMES))
    assert all(len(line) > 1 for line in LINES)


def test_embeddings_are_of_length_1_and_share_what_clips_do() -> None:
    embeddings = TEXTS.embed(NAMES)
    assert embeddings.shape == (len(NAMES), 512)
    assert embeddings.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(embeddings, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(embeddings @ common_direction(), np.sqrt(0.7), atol=1e-6)
    cosines = (embeddings @ embeddings.T)[~np.eye(len(NAMES), dtype=bool)]
    assert 0.68 < cosines.mean() < 0.74


def test_every_name_lies_nearest_to_its_own_concept() -> None:
    concepts = [line[0] for line in LINES]
    cosines = TEXTS.embed(NAMES) @ TEXTS.embed(concepts).T
    nearest = [concepts[column] for column in cosines.argmax(axis=1)]
    assert nearest == [line[0] for line in LINES for _ in line]
    assert cosines.max(axis=1).min() > 0.94
    assert [TEXTS.concept(name) for name in NAMES] == nearest


def test_a_family_lies_closer_together_than_strangers_do() -> None:
    families = {line.split(", ")[0]: f for f, lines in _TABLE.items() for line in lines}
    embeddings = TEXTS.embed(list(families))
    of = np.array(list(families.values()))
    together = (of[:, None] == of) & ~np.eye(len(of), dtype=bool)
    cosines = embeddings @ embeddings.T
    assert cosines[together].min() > cosines[of[:, None] != of].max()


def test_an_embedding_depends_on_its_own_text_alone() -> None:
    alone, among = TEXTS.embed(["lamp"]), BuiltinTexts().embed(["sofa", "lamp", "cup"])
    np.testing.assert_array_equal(alone[0], among[1])
    assert TEXTS.embed([]).shape == (0, 512)


def test_adjectives_shift_a_name_and_articles_and_plurals_do_not() -> None:
    chair, article, plural, red, blue, sofa = TEXTS.embed(
        ["chair", "A Chair", "chairs", "a red chair", "blue chair", "red sofa"]
    )
    np.testing.assert_array_equal(chair, article)
    np.testing.assert_array_equal(chair, plural)
    assert red @ chair > max(red @ sofa, red @ blue, 0.95)
    assert red @ sofa > chair @ sofa
    assert TEXTS.concept("a red chair") == "chair"


@pytest.mark.parametrize(("unknown", "near"), [("soffa", "sofa"), ("a red wardrob", "wardrobe")])
def test_an_unknown_word_is_an_error_that_names_its_neighbours(unknown: str, near: str) -> None:
    assert not TEXTS.knows(unknown)
    with pytest.raises(ProgroundError, match=repr(near)) as caught:
        TEXTS.embed(["chair", unknown])
    assert "--detector and --text-encoder or --vocabulary" in caught.value.where


def test_it_knows_every_class_of_the_room() -> None:
    assert all(TEXTS.knows(name) for name in CLASSES)
    assert len({TEXTS.concept(name) for name in CLASSES}) == len(CLASSES)


def test_it_knows_every_class_of_the_house(shared_data: Path) -> None:
    info = json.loads((shared_data / "aws_small_house_labelled/info_semantic.json").read_text())
    names = [c["name"] for c in info["classes"] if c["id"] > 0]
    assert len({TEXTS.concept(name) for name in names}) == 38
