"""The text encoder: CLIP's tokens in, embeddings of length 1 out, broken files refused."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import TensorProto

from proground_log.errors import ProgroundError
from proground_log.perception.onnx.session import OnnxModel, open_session
from proground_log.perception.onnx.text_encoder import OnnxTextEncoder
from proground_log.perception.onnx.tokenizer import CONTEXT, END, START, _tokenizer, tokens
from proground_log.perception.vocabulary import Vocabulary, build_vocabulary
from tests.perception.onnx.tiny_encoders import write_text_encoder


@pytest.fixture(scope="module")
def encoder_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("encoder") / "clip-text.onnx"
    write_text_encoder(path)
    return path


# What the tokenizers of OpenAI's CLIP, open_clip and transformers give, as published by others.
@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a photo of a cat", [320, 1125, 539, 320, 2368]),
        ("a diagram", [320, 22697]),
        ("hello world", [3306, 1002]),
        ("  HELLO   World  ", [3306, 1002]),
        ("mobileclip", [9451, 944, 8546]),
        ("hatbox", [3447, 2063]),
        ("hat box", [3801, 2063]),
        ("MacBook Pro 16-inch", [20617, 2630, 272, 277, 268, 6523]),
        ("the year 2024 was interesting", [518, 935, 273, 271, 273, 275, 739, 3628]),
        (
            "i can't believe it's not butter",
            [328, 753, 713, 2649, 585, 568, 783, 6952],
        ),
        ("café", [15304]),
        ("🐶", [10631]),
    ],
)
def test_tokens_are_those_of_clip(text: str, expected: list[int]) -> None:
    padding = [0] * (CONTEXT - 2 - len(expected))
    assert tokens(text).tolist() == [START, *expected, END, *padding]
    assert tokens(text).dtype == np.int64


@given(st.text(max_size=20))
def test_any_text_has_one_end_and_then_nothing(text: str) -> None:
    row = tokens(text)
    end = int(row.argmax())
    assert (row[0], row[end]) == (START, END)
    assert not row[end + 1 :].any()
    assert START not in row[1:]


def test_the_longest_text_fits_and_one_more_word_does_not() -> None:
    assert tokens("cat " * 75)[-1] == END
    with pytest.raises(ProgroundError, match=r"76 tokens.*at most 75"):
        tokens("cat " * 76)


def test_a_missing_tokenizer_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "instant_clip_tokenizer", None)
    _tokenizer.cache_clear()
    with pytest.raises(ProgroundError, match=r"pip install 'proground-log\[text-encoder\]'"):
        tokens("cat")


def test_an_embedding_is_the_networks_for_the_sentence_at_length_1(tmp_path: Path) -> None:
    weights = write_text_encoder(tmp_path / "text.onnx")
    embeddings = OnnxTextEncoder(tmp_path / "text.onnx", "this is a {}").embed(
        ["Cat", "red  chair"]
    )
    for text, embedding in zip(["this is a cat", "this is a red chair"], embeddings, strict=True):
        expected = tokens(text).astype(np.float64) @ weights.astype(np.float64)
        np.testing.assert_allclose(embedding, expected / np.linalg.norm(expected), atol=1e-5)
    assert (embeddings.dtype, embeddings.shape) == (np.float32, (2, 512))


def test_a_text_has_the_same_bits_in_any_company(encoder_path: Path) -> None:
    encoder = OnnxTextEncoder(encoder_path)
    names = [f"{color} {thing}" for color in ("red", "blue") for thing in ("cup", "sofa", "lamp")]
    together = encoder.embed(names)
    np.testing.assert_array_equal(together, np.concatenate([encoder.embed([n]) for n in names]))
    np.testing.assert_array_equal(together, OnnxTextEncoder(encoder_path).embed(names))
    assert encoder.embed([]).shape == (0, 512)


def test_a_file_for_one_text_at_a_time_will_do(encoder_path: Path, tmp_path: Path) -> None:
    write_text_encoder(tmp_path / "one.onnx", batch=1)
    one = OnnxTextEncoder(tmp_path / "one.onnx")
    names = ["cup", "sofa"]
    np.testing.assert_array_equal(one.embed(names), OnnxTextEncoder(encoder_path).embed(names))
    assert one.origin["sha256"] != OnnxTextEncoder(encoder_path).origin["sha256"]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"name": "tokens"}, "asks for an input 'tokens', which no text encoder gets"),
        ({"output": "text_embeds"}, "has no output 'embeddings', so it is no text encoder"),
        ({"element": TensorProto.INT32}, r"'input_ids' is tensor\(int32\), not int64"),
        ({"context": 64}, r"'input_ids' has shape \[N, 64\], not \[1, 77\]"),
        ({"batch": 4}, r"'input_ids' has shape \[4, 77\], not \[1, 77\]"),
        ({"width": 768}, r"'embeddings' has shape \[N, 768\], not \[1, 512\]"),
    ],
)
def test_a_file_that_breaks_the_contract_is_refused(
    tmp_path: Path, changed: dict[str, object], message: str
) -> None:
    path = tmp_path / "broken.onnx"
    write_text_encoder(path, **changed)
    with pytest.raises(ProgroundError, match=message) as caught:
        OnnxTextEncoder(path)
    assert caught.value.where == str(path)


@pytest.mark.parametrize("content", [b"", b"no network", b"\x08\x07"])
def test_what_is_no_onnx_file_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "broken.onnx"
    path.write_bytes(content)
    with pytest.raises(ProgroundError, match="is no ONNX file"):
        OnnxTextEncoder(path)
    with pytest.raises(ProgroundError, match="no such file"):
        OnnxTextEncoder(tmp_path / "missing.onnx")


def open_encoder(path: Path) -> OnnxModel:
    return open_session(
        path,
        kind="text encoder",
        inputs={"input_ids": ("N", CONTEXT)},
        outputs={"embeddings": (1, 512)},
        optional_outputs={"masks": ("N", 32)},
        int64=("input_ids",),
    )


def test_a_model_says_what_it_has(encoder_path: Path) -> None:
    model = open_encoder(encoder_path)
    assert model.output_names == {"embeddings"}
    assert model.metadata == {"proground.contract": "1"}
    assert model.sha256 == hashlib.sha256(encoder_path.read_bytes()).hexdigest()


def test_sizes_that_a_file_leaves_open_are_checked_when_it_runs(encoder_path: Path) -> None:
    with pytest.raises(ProgroundError, match=r"'embeddings' has shape \[2, 512\], not \[1, 512\]"):
        open_encoder(encoder_path).run({"input_ids": np.zeros((2, CONTEXT), np.int64)})


def test_an_input_that_the_network_refuses_is_an_error_of_its_file(encoder_path: Path) -> None:
    with pytest.raises(ProgroundError, match="cannot be run") as caught:
        open_encoder(encoder_path).run({"input_ids": np.zeros((1, 5), np.int64)})
    assert caught.value.where == str(encoder_path)


@pytest.mark.parametrize("value", [0, np.nan, np.inf])
def test_an_embedding_without_direction_is_refused(tmp_path: Path, value: float) -> None:
    path = tmp_path / "flat.onnx"
    write_text_encoder(path, weights=np.full((77, 512), value, np.float32))
    with pytest.raises(ProgroundError, match="0 or not finite"):
        OnnxTextEncoder(path).embed(["cup"])


def test_an_empty_text_and_a_template_without_a_place_are_refused(encoder_path: Path) -> None:
    with pytest.raises(ProgroundError, match="empty text"):
        OnnxTextEncoder(encoder_path).embed(["cup", "  "])
    with pytest.raises(ProgroundError, match="template 'a cup'"):
        OnnxTextEncoder(encoder_path, "a cup")


def test_a_vocabulary_that_an_encoder_builds_stands_in_for_it(
    encoder_path: Path, tmp_path: Path
) -> None:
    encoder, told = OnnxTextEncoder(encoder_path), []
    (tmp_path / "names.txt").write_text("# seats\nsofa\n\n  red   chair  # mine\nTV\n")
    for output in ("first.npz", "second.npz"):
        build_vocabulary(
            tmp_path / "names.txt", encoder, tmp_path / output, lambda *done: told.append(done)
        )
    vocabulary = Vocabulary(tmp_path / "first.npz")
    assert vocabulary.names == ("sofa", "red chair", "TV")
    np.testing.assert_allclose(
        vocabulary.embed(["tv", "red chairs"]), encoder.embed(["tv", "red chair"]), atol=5e-4
    )
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)] * 2
    assert (tmp_path / "first.npz").read_bytes() == (tmp_path / "second.npz").read_bytes()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"# nothing\n\n", "has no names"),
        (b"cup\nCup\n", "'Cup' twice"),
        (b"caf\xe9\n", "no UTF-8"),
    ],
)
def test_a_list_of_names_with_a_fault_is_refused_before_work(
    encoder_path: Path, tmp_path: Path, content: bytes, message: str
) -> None:
    (tmp_path / "names.txt").write_bytes(content)
    told: list[tuple[int, int]] = []
    with pytest.raises(ProgroundError, match=message):
        build_vocabulary(
            tmp_path / "names.txt",
            OnnxTextEncoder(encoder_path),
            tmp_path / "out.npz",
            lambda *done: told.append(done),
        )
    assert (told, (tmp_path / "out.npz").exists()) == ([], False)
