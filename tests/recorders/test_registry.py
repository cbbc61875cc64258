from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from proground_log.errors import ProgroundError
from recorders.registry import FORMATS, open_source


@pytest.mark.parametrize("name", FORMATS)
def test_each_source_bears_the_name_of_its_format(name: str) -> None:
    assert FORMATS[name].opener().name == name  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", [name for name, each in FORMATS.items() if each.takes_source])
def test_each_format_refuses_an_empty_folder(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "freiburg1"
    folder.mkdir()
    with pytest.raises(ProgroundError, match="freiburg1"):
        open_source(name, folder)


@pytest.mark.parametrize("name", [name for name, each in FORMATS.items() if each.takes_source])
def test_what_is_not_there_is_the_same_error_for_each_format(name: str, tmp_path: Path) -> None:
    with pytest.raises(ProgroundError) as caught:
        open_source(name, tmp_path / "nosuch")
    assert str(caught.value) == f"{tmp_path}/nosuch: no such folder or file; check the path"


def test_an_unknown_format_lists_the_valid_ones(tmp_path: Path) -> None:
    with pytest.raises(ProgroundError, match="did you mean seven-scenes\\?") as caught:
        open_source("sevenscenes", tmp_path)
    assert all(name in str(caught.value) for name in FORMATS)


def test_an_unknown_option_is_an_unknown_argument(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="max_time_difference"):
        open_source("tum", tmp_path, max_time_difference=0.1)


def test_a_source_is_given_exactly_where_one_is_needed(tmp_path: Path) -> None:
    with pytest.raises(ProgroundError, match="format tum: needs a source"):
        open_source("tum")
    with pytest.raises(ProgroundError, match="format synthetic: has no use for"):
        open_source("synthetic", tmp_path)


def test_formats_are_imported_only_when_opened() -> None:
    modules = {each.module for each in FORMATS.values()}
    code = f"import sys, recorders.registry; sys.exit(bool({modules!r} & sys.modules.keys()))"
    subprocess.run([sys.executable, "-c", code], check=True)
