"""The vocabulary: finds names as people write them, refuses what is broken, writes equal bytes."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from proground_log.errors import ProgroundError
from proground_log.perception.texts import NameIndex, nearest_names
from proground_log.perception.vocabulary import Vocabulary, write_vocabulary

NAMES = ("Chair", "bow-tie", "bow tie", "knife", "box", "glasses", "glass", "television stand")


def random_embeddings(count: int) -> np.ndarray:
    embeddings = np.random.default_rng(count).normal(size=(count, 512))
    return embeddings / np.linalg.norm(embeddings, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def vocabulary_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("vocabulary") / "words.npz"
    write_vocabulary(path, NAMES, random_embeddings(len(NAMES)))
    return path


def test_what_is_written_is_read(vocabulary_path: Path) -> None:
    vocabulary = Vocabulary(vocabulary_path)
    assert vocabulary.names == NAMES
    embeddings = vocabulary.embed(NAMES)
    np.testing.assert_allclose(embeddings, random_embeddings(len(NAMES)), atol=2e-4)
    np.testing.assert_allclose(np.linalg.norm(embeddings, axis=1), 1, atol=1e-6)
    assert embeddings.dtype == np.float32
    assert vocabulary.embed([]).shape == (0, 512)


@pytest.mark.parametrize(
    ("asked", "meant"),
    [
        ("chair", "Chair"),
        ("  CHAIRS ", "Chair"),
        ("television_stand", "television stand"),
        ("Television-Stands", "television stand"),
        ("bow-tie", "bow-tie"),
        ("bow  tie", "bow tie"),
        ("bow_tie", "bow tie"),
        ("knives", "knife"),
        ("boxes", "box"),
        ("glasses", "glasses"),
    ],
)
def test_a_name_is_found_as_people_write_it(asked: str, meant: str) -> None:
    assert NameIndex(NAMES, "here").row(asked) == NAMES.index(meant)


@given(st.lists(st.text("abcs-_ ", min_size=1, max_size=6), min_size=1, max_size=8))
def test_every_name_finds_itself_or_the_list_is_refused(names: list[str]) -> None:
    spelled = [" ".join(name.split()) for name in names]
    if "" in spelled or len(set(spelled)) < len(spelled):
        with pytest.raises(ProgroundError, match=r"empty name|twice"):
            NameIndex(names, "here")
    else:
        index = NameIndex(names, "here")
        assert [index.row(name.upper()) for name in names] == list(range(len(names)))


def test_an_unknown_name_is_told_its_nearest(vocabulary_path: Path) -> None:
    with pytest.raises(ProgroundError, match=r"does not know 'tv stand'; .* 'television stand'"):
        Vocabulary(vocabulary_path).embed(["chair", "tv stand"])


@given(st.permutations(NAMES), st.text("abcdefghistv ", max_size=12))
def test_the_nearest_do_not_depend_on_the_order_of_names(names: list[str], asked: str) -> None:
    assert nearest_names(asked, names) == nearest_names(asked, NAMES)


def test_equal_content_gives_equal_bytes(tmp_path: Path, vocabulary_path: Path) -> None:
    write_vocabulary(tmp_path / "again.npz", list(NAMES), random_embeddings(len(NAMES)))
    assert (tmp_path / "again.npz").read_bytes() == vocabulary_path.read_bytes()
    # A time of writing would only show in a file that is written seconds later.
    with zipfile.ZipFile(vocabulary_path) as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
    again = Vocabulary(tmp_path / "again.npz")
    write_vocabulary(tmp_path / "third.npz", again.names, again.embeddings)
    assert (tmp_path / "third.npz").read_bytes() == vocabulary_path.read_bytes()


GOOD = random_embeddings(3).astype(np.float16)
NOT_FINITE, TOO_LONG = GOOD.copy(), GOOD.copy()
NOT_FINITE[1, 7], TOO_LONG[1] = np.nan, 1.01 * GOOD[1]


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"names": ["a", "b", "c"]}, "has no array 'embeddings'"),
        ({"embeddings": GOOD}, "has no array 'names'"),
        ({"names": ["a", "b", "c"], "embeddings": GOOD[:, :384]}, r"shape \[3, 384\]"),
        ({"names": ["a", "b", "c"], "embeddings": GOOD[0]}, r"shape \[512\]"),
        ({"names": ["a", "b", "c"], "embeddings": GOOD.astype(np.float32)}, "float32"),
        ({"names": ["a", "b"], "embeddings": GOOD}, "2 names and 3 embeddings"),
        ({"names": ["a", "b", "A "], "embeddings": GOOD}, "'A ' twice"),
        ({"names": ["a", "b", ""], "embeddings": GOOD}, "empty name"),
        ({"names": [1, 2, 3], "embeddings": GOOD}, r"names are int64 \[3\], not str"),
        ({"names": np.zeros(0, "U1"), "embeddings": GOOD[:0]}, "no names"),
        ({"names": ["a", "b", "c"], "embeddings": NOT_FINITE}, "'b' has length nan"),
        ({"names": ["a", "b", "c"], "embeddings": TOO_LONG}, "'b' has length 1.01"),
        (
            {"names": np.array(["a", "b", "c"], object), "embeddings": GOOD},
            "no .npz file of plain arrays",
        ),
    ],
)
def test_a_file_that_breaks_the_contract_is_refused(
    tmp_path: Path, arrays: dict[str, Any], message: str
) -> None:
    path = tmp_path / "broken.npz"
    np.savez(path, **arrays)
    with pytest.raises(ProgroundError, match=message) as caught:
        Vocabulary(path)
    assert caught.value.where == str(path)


def test_what_is_no_npz_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ProgroundError, match="no such file"):
        Vocabulary(tmp_path / "missing.npz")
    array = io.BytesIO()
    np.save(array, GOOD)
    for content in (b"", b"chair\ntable\n", array.getvalue()):
        (tmp_path / "broken.npz").write_bytes(content)
        with pytest.raises(ProgroundError, match=r"\.npz file"):
            Vocabulary(tmp_path / "broken.npz")


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_damage_is_refused_or_does_no_harm(vocabulary_path: Path, data: st.DataObject) -> None:
    content = bytearray(vocabulary_path.read_bytes())
    if data.draw(st.booleans()):
        del content[data.draw(st.integers(0, len(content) - 1)) :]
    else:
        # Most bytes are embeddings; the two ends are what holds the archive together.
        at = data.draw(st.integers(0, 400) | st.integers(-300, -1))
        content[at] ^= data.draw(st.integers(1, 255))
    damaged = vocabulary_path.with_name("damaged.npz")
    damaged.write_bytes(content)
    try:
        vocabulary = Vocabulary(damaged)
    except ProgroundError:
        return
    assert vocabulary.names == NAMES
    np.testing.assert_array_equal(vocabulary.embeddings, Vocabulary(vocabulary_path).embeddings)


def test_nothing_broken_is_written(tmp_path: Path) -> None:
    for names, embeddings in (
        (["a", "b", "a"], GOOD),
        (["a", "b"], GOOD),
        (["a", "b", "c"], 2 * GOOD),
        (["a", "b", "c"], NOT_FINITE),
    ):
        with pytest.raises(ProgroundError):
            write_vocabulary(tmp_path / "out.npz", names, embeddings)
    assert list(tmp_path.iterdir()) == []


def test_the_real_vocabulary_of_clip(shared_data: Path) -> None:
    path = shared_data.parent / "models" / "clip-vit-b32-vocabulary.npz"
    if not path.is_file():
        pytest.skip(f"no vocabulary {path}")
    vocabulary = Vocabulary(path)
    assert len(vocabulary.names) == 1612
    cosines = vocabulary.embeddings @ vocabulary.embeddings.T
    assert cosines.mean() == pytest.approx(0.74, abs=0.01)
    sofa, couch, chairs, knife = vocabulary.embed(["Sofa", "couch", "chairs", "knives"])
    assert sofa @ couch > sofa @ chairs > sofa @ knife
    for row, name in enumerate(vocabulary.names):
        np.testing.assert_array_equal(vocabulary.embed([name])[0], vocabulary.embeddings[row])
    with pytest.raises(ProgroundError, match=r"'washing mashine'; .* are 'washing machine',"):
        vocabulary.embed(["washing mashine"])
