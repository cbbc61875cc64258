"""Changes to bytes and to text, each a function of the data and a seeded generator."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

Mutator = Callable[[bytes, np.random.Generator], bytes]

MOST_CHANGES = 4
EDGE_BYTES = 300
"""Headers and footers, where half of all changes go."""
LONGEST_BLOCK = 64
NUMBERS = (0, 1, -1, 2**31, 2**32 - 1, 2**63)
BYTES = (0, 255, 127, 128)
WORDS = (
    *(b"0", b"-1", b"1", b"nan", b"NaN", b"inf", b"-inf", b"1e-320", b"1e308", b"1e999999999"),
    *(b"4294967295", b"9223372036854775808", b"9" * 5000, b"0x10", b"1_0", b"\xd9\xa3", b"true"),
    *(b"null", b"[]", b"{}", b'""', b'"x"', b"[" * 100_000, b'"../../x"', b'"/x"', b'"\\u0000"'),
    *(b"\0", b"\xff", b"\n", b""),
)
"""What may stand in place of a word: numbers that are none or too large, other kinds of JSON."""

_WORD = re.compile(rb'"[^"]*"|[^\s,:"\[\]{}&]+')


def pick(rng: np.random.Generator, choices: tuple[object, ...]) -> object:
    """One of them."""
    return choices[int(rng.integers(len(choices)))]


def of_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Bits, bytes, numbers or whole blocks changed, at one to four places."""
    changed = bytearray(data)
    for _ in range(rng.integers(1, MOST_CHANGES + 1)):
        _CHANGES[rng.integers(len(_CHANGES))](changed, rng)
    return bytes(changed)


def of_words(data: bytes, rng: np.random.Generator) -> bytes:
    """Words of a text replaced, taken out, or put elsewhere; text is also changed as bytes."""
    if rng.random() < 0.2:
        return of_bytes(data, rng)
    for _ in range(rng.integers(1, MOST_CHANGES + 1)):
        found = [match.span() for match in _WORD.finditer(data)]
        if not found:
            return data
        start, end = found[rng.integers(len(found))]
        other = found[rng.integers(len(found))]
        word = data[slice(*other)] if rng.random() < 0.3 else WORDS[rng.integers(len(WORDS))]
        data = data[:start] + word + data[end:]
    return data


def _place(data: bytearray, rng: np.random.Generator) -> int:
    size = max(1, len(data))
    edge = min(size, EDGE_BYTES)
    where = rng.random()
    if where < 0.3:
        return int(rng.integers(edge))
    return int(rng.integers(size - edge, size) if where < 0.5 else rng.integers(size))


def _block(data: bytearray, rng: np.random.Generator) -> slice:
    start = _place(data, rng)
    return slice(start, min(len(data), start + int(rng.integers(1, LONGEST_BLOCK + 1))))


def _flip_bit(data: bytearray, rng: np.random.Generator) -> None:
    if data:
        data[_place(data, rng)] ^= 1 << int(rng.integers(8))


def _set_byte(data: bytearray, rng: np.random.Generator) -> None:
    if data:
        data[_place(data, rng)] = BYTES[rng.integers(len(BYTES))]


def _set_number(data: bytearray, rng: np.random.Generator) -> None:
    """An integer of four or eight bytes becomes an extreme one, or nearly what it was."""
    size, at = int(rng.choice([4, 8])), _place(data, rng)
    was = int.from_bytes(data[at : at + size], "little")
    values = (*NUMBERS, was + 1, was - 1, len(data), len(data) - 1, len(data) + 1)
    value = values[rng.integers(len(values))] % 2 ** (8 * size)
    data[at : at + size] = value.to_bytes(size, "little")


def _cut_end(data: bytearray, rng: np.random.Generator) -> None:
    del data[_place(data, rng) :]


def _cut_out(data: bytearray, rng: np.random.Generator) -> None:
    del data[_block(data, rng)]


def _insert(data: bytearray, rng: np.random.Generator) -> None:
    at, size = _place(data, rng), int(rng.integers(1, LONGEST_BLOCK + 1))
    data[at:at] = rng.bytes(size) if rng.random() < 0.5 else bytes(size)


def _duplicate(data: bytearray, rng: np.random.Generator) -> None:
    block = data[_block(data, rng)]
    at = _place(data, rng)
    data[at:at] = block


def _swap(data: bytearray, rng: np.random.Generator) -> None:
    size = int(rng.integers(1, LONGEST_BLOCK + 1))
    first, second = sorted(_place(data, rng) for _ in range(2))
    if first + size <= second and second + size <= len(data):
        one, other = slice(first, first + size), slice(second, second + size)
        data[one], data[other] = data[other], data[one]


_CHANGES = (
    *(_flip_bit, _set_byte, _set_number, _set_number),
    *(_cut_end, _cut_out, _insert, _duplicate, _swap),
)
