from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from proground_log.errors import ProgroundError
from proground_log.files import disk_errors, require_file, require_free, written_whole
from tests.full_disk import largest_file


def write(path: Path, content: bytes = b"") -> None:
    with written_whole(path) as temporary:
        temporary.write_bytes(content)


def test_an_error_says_where_what_and_what_to_do() -> None:
    error = ProgroundError("is too large", where=Path("a/b.png"), todo="shrink it")
    assert str(error) == "a/b.png: is too large; shrink it"
    assert (error.what, error.where, error.todo) == ("is too large", "a/b.png", "shrink it")


def test_a_file_is_required(tmp_path: Path) -> None:
    file = tmp_path / "a"
    with pytest.raises(ProgroundError, match="a: no such file; check the path"):
        require_file(file)
    with pytest.raises(ProgroundError, match="is a folder, not a file"):
        require_file(tmp_path)
    file.touch()
    assert require_file(file) == file


def test_an_output_has_to_be_free(tmp_path: Path) -> None:
    file = tmp_path / "a"
    assert require_free(file, overwrite=False) == file
    file.touch()
    with pytest.raises(ProgroundError, match=r"the output exists; .* --overwrite"):
        require_free(file, overwrite=False)
    assert require_free(file, overwrite=True) == file
    for overwrite in (False, True):
        with pytest.raises(ProgroundError, match="the output is a folder"):
            require_free(tmp_path, overwrite=overwrite)


def test_a_file_takes_its_name_once_it_is_whole(tmp_path: Path) -> None:
    file = tmp_path / "new" / "folder" / "a.bin"
    with written_whole(file) as temporary:
        temporary.write_bytes(b"1")
        assert not file.exists()
        assert temporary.parent == file.parent
    assert file.read_bytes() == b"1"
    with written_whole(file) as temporary:
        temporary.write_bytes(b"22")
        assert file.read_bytes() == b"1"
    assert file.read_bytes() == b"22"
    assert list(file.parent.iterdir()) == [file]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, ProgroundError, SystemExit])
def test_an_interruption_leaves_what_was_there(tmp_path: Path, error: type[BaseException]) -> None:
    file = tmp_path / "a.bin"
    file.write_bytes(b"before")
    details = {"where": "here", "todo": "wait"} if error is ProgroundError else {}

    def interrupted() -> None:
        with written_whole(file) as temporary:
            temporary.write_bytes(b"half")
            raise error("stop", **details)

    with pytest.raises(error):
        interrupted()
    assert file.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [file]


def test_a_full_disk_leaves_what_was_there(tmp_path: Path) -> None:
    file = tmp_path / "a.bin"
    file.write_bytes(b"before")
    message = r"a\.bin: cannot write: .*; .* write elsewhere"
    with largest_file(1000), pytest.raises(ProgroundError, match=message):
        write(file, bytes(2000))
    assert file.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO])
def test_what_a_disk_refuses_names_the_output(number: int) -> None:
    reason = os.strerror(number).lower()
    message = f"^out/log: cannot write: {reason}; "
    with pytest.raises(ProgroundError, match=message), disk_errors(Path("out/log")):
        raise OSError(number, os.strerror(number))


def test_an_error_on_another_file_is_not_blamed_on_the_output() -> None:
    with pytest.raises(PermissionError, match=r"source\.png"), disk_errors(Path("out/log")):
        raise PermissionError(errno.EACCES, "Permission denied", "source.png")


def test_a_folder_that_is_a_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "a").touch()
    with pytest.raises(ProgroundError, match=r"a/b/c\.bin: cannot write: not a directory"):
        write(tmp_path / "a" / "b" / "c.bin")
    with pytest.raises(ProgroundError, match=r"a/c\.bin: cannot write: file exists"):
        write(tmp_path / "a" / "c.bin")


def test_a_name_that_is_too_long_is_named(tmp_path: Path) -> None:
    with pytest.raises(ProgroundError, match="cannot write: file name too long; choose a shorter"):
        write(tmp_path / ("a" * 250))


def test_a_killed_process_leaves_no_file_under_the_name(tmp_path: Path) -> None:
    code = (
        "import os, sys; from pathlib import Path; from proground_log.files import written_whole\n"
        "with written_whole(Path(sys.argv[1])) as temporary:\n"
        "    temporary.write_bytes(b'half'); os.kill(os.getpid(), 9)"
    )
    file = tmp_path / "a.bin"
    result = subprocess.run([sys.executable, "-c", code, str(file)], check=False)
    assert result.returncode == -signal.SIGKILL
    assert not file.exists()
