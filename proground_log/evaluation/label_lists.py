"""The truth that a map's names are judged by: candidate names, labels, and a mesh with them."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from proground_log.errors import ProgroundError
from proground_log.files import require_file

EXCLUDED = (
    "door",
    "window",
    "wall",
    "floor",
    "ceiling",
    "column",
    "beam",
    "stair",
    "tabletop",
    "light",
    "appliance",
    "furniture",
    "other",
    "unknown",
)
"""Things with one of these in their name are not judged (protocol of HOV-SG, which the paper
follows). Substrings, as there: a wallet and a flashlight go as well."""
NAME_COLUMNS = ("nyuClass", "name", "class", "label", "category")
"""What the column of names may be called in a CSV file."""
_RAW, _CLASS = "category", "nyuClass"
_HEADER = re.compile(rb"\Aply\r?\n(.*?)^end_header\r?\n", re.DOTALL | re.MULTILINE)
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}


def plain(name: str) -> str:
    """A name as it is compared: lower case, with a space for '-', '_' and any run of spaces.

    >>> plain("Coffee-Table ")
    'coffee table'
    """
    return " ".join(re.sub("[-_]", " ", name).lower().split())


def read_names(path: Path) -> tuple[str, ...]:
    """The candidate names of a file, in its order.

    Args:
        path: *.csv with a header that has one of `NAME_COLUMNS`, such as the 894 names of NYUv2;
            any other file is text with one name a line.

    Raises:
        ProgroundError: it is not such a file, has no names, or has one twice.
    """
    if path.suffix.lower() == ".csv":
        rows = _read_csv(path)
        column = next((name for name in NAME_COLUMNS if rows and name in rows[0]), None)
        if column is None:
            raise _error("has no column of names", path, f"call it {', '.join(NAME_COLUMNS)}")
        lines = [row[column] for row in rows]
    else:
        lines = _read_text(path).splitlines()
    names = [" ".join(line.split()) for line in lines]
    names = [name for name in names if name]
    if not names:
        raise _error("has no names", path, "give one name a line")
    seen: set[str] = set()
    for name in names:
        if plain(name) in seen:
            raise _error(f"has the name {name!r} twice", path, "remove one of them")
        seen.add(plain(name))
    return tuple(names)


def read_mapping(path: Path) -> dict[str, str]:
    """What labels are called among the candidates: plain name to plain name, or to "" for none.

    Args:
        path: CSV whose header has the columns category and nyuClass, such as the published map
            of HM3DSem.

    Raises:
        ProgroundError: it is not such a file, or maps one category to two classes.
    """
    rows = _read_csv(path)
    if not rows or not {_RAW, _CLASS} <= set(rows[0]):
        raise _error(f"has no columns {_RAW} and {_CLASS}", path, "check the file")
    mapping: dict[str, str] = {}
    for row in rows:
        raw, name = plain(row[_RAW]), plain(row[_CLASS])
        if mapping.setdefault(raw, name) != name:
            raise _error(f"maps {raw!r} to {mapping[raw]!r} and to {name!r}", path, "remove one")
    return mapping


def candidates_of(
    label_names: Mapping[int, str],
    names: Sequence[str],
    mapping: Mapping[str, str] | None = None,
    excluded: Sequence[str] = EXCLUDED,
) -> dict[int, int]:
    """Which candidate each label means.

    Args:
        label_names: names of the labels, as a log has them.
        names: the candidates; they are compared as `plain` has them.
        mapping: of `read_mapping`; labels that it does not list keep their own name.
        excluded: labels with one of these in their mapped name are not judged.

    Returns:
        By label the candidate's number, or -1 for what is excluded or no candidate.

    >>> candidates_of({1: "Office Chair", 2: "rug"}, ["chair", "table"], {"office chair": "chair"})
    {1: 0, 2: -1}
    """
    number = {plain(name): index for index, name in enumerate(names)}
    found = {}
    for label, own in label_names.items():
        name = (mapping or {}).get(plain(own), plain(own))
        found[label] = -1 if any(part in name for part in excluded) else number.get(name, -1)
    return found


def truth_of(labels: np.ndarray, candidates: Mapping[int, int]) -> np.ndarray:
    """The candidate [V] that labels [V] mean by `candidates_of`; -1 for labels without a name."""
    present, place = np.unique(labels, return_inverse=True)
    return np.array([candidates.get(int(label), -1) for label in present], np.int64)[place]


def read_labelled_mesh(
    content: bytes, *, where: object
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Vertices, labels and instances of a PLY mesh or point cloud, binary or text.

    Args:
        content: the file; of a vertex it must have x, y, z and label, and may have instance.
        where: where it is from.

    Returns:
        vertices float64 [V, 3] in metres, labels int64 [V], instances int64 [V] or None.

    Raises:
        ProgroundError: it is no PLY, is damaged, or has no labels.
    """
    columns = _ply_vertices(content, where)
    missing = [name for name in ("x", "y", "z", "label") if name not in columns]
    if missing:
        raise _error(f"its vertices have no {missing[0]}", where, "give a labelled mesh")
    vertices_m = np.stack([columns[axis].astype(np.float64) for axis in "xyz"], axis=-1)
    if not np.isfinite(vertices_m).all():
        raise _error("has vertices that are nowhere", where, "write the mesh again")
    instances = _whole(columns, "instance", where) if "instance" in columns else None
    return vertices_m, _whole(columns, "label", where), instances


def _ply_vertices(content: bytes, where: object) -> dict[str, np.ndarray]:
    """The properties [V] of the vertices of a PLY file, by name."""
    todo = "write the mesh again, with its vertices first"
    header = _HEADER.match(content)
    if header is None:
        raise _error("is no PLY", where, todo)
    order, elements, record = "", [], []
    for line in header[1].decode("ascii", "replace").splitlines():
        match line.split():
            case ["format", name, "1.0"] if name in _ORDERS:
                order = name
            case ["element", name, count] if re.fullmatch("[0-9]{1,12}", count):
                elements.append((name, int(count)))
            case ["property", kind, name] if order and kind in _TYPES and len(elements) == 1:
                record.append((name, _ORDERS[order] + _TYPES[kind]))
            case ["comment" | "obj_info", *_] | []:
                pass
            case ["property", *_] if len(elements) > 1:
                pass  # Of the faces: they are not needed.
            case _:
                raise _error(f"has a header that cannot be read ({line.strip()!r})", where, todo)
    if not record or elements[0][0] != "vertex":
        raise _error("does not begin with vertices", where, todo)
    names = [name for name, _ in record]
    if len(set(names)) < len(names):
        raise _error("has a property of its vertices twice", where, todo)
    count, body = elements[0][1], content[header.end() :]
    try:
        if order == "ascii":
            words = count * len(names)
            numbers = np.array(body.split(None, words)[:words], np.float64)
            return dict(zip(names, numbers.reshape(count, len(names)).T, strict=True))
        rows = np.frombuffer(body, np.dtype(record), count)
        return {name: rows[name] for name in names}
    except ValueError as error:
        raise _error("ends before its vertices do, or they are damaged", where, todo) from error


def _whole(columns: dict[str, np.ndarray], name: str, where: object) -> np.ndarray:
    """A property as int64; some programs keep whole numbers as floats."""
    with np.errstate(invalid="ignore"):
        whole = columns[name].astype(np.int64)
    if not (whole == columns[name]).all():
        raise _error(f"has a {name} that is no whole number", where, "write the mesh again")
    return whole


def _read_csv(path: Path) -> list[dict[str, str]]:
    """The rows of a CSV file by its header; short ones are filled up with ""."""
    try:
        return list(csv.DictReader(_read_text(path).splitlines(), restval="", strict=True))
    except csv.Error as error:
        raise _error(f"is no CSV ({error})", path, "check the file") from error


def _read_text(path: Path) -> str:
    try:
        return require_file(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise _error("is no text in UTF-8", path, "check the file") from error


def _error(what: str, where: object, todo: str) -> ProgroundError:
    return ProgroundError(what, where=where, todo=todo)
