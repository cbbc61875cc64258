"""The wheel, installed as users install it: everything that it needs is in it."""

from __future__ import annotations

import configparser
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from tests.checkout import ROOT, needs_checkout, pyproject

pytestmark = [needs_checkout, pytest.mark.slow]

PACKAGES = ("pglog", "proground_log", "recorders", "replay")
SMALL = (
    *("--steps", 2, "--mapper.sampling.rays", 64, "--mapper.field.log2-rows", 12),
    *("--mapper.field.levels", 4, "--mapper.buffer.capacity", 2000),
    *("--mapper.buffer.keyframe-samples", 500),
    "--telemetry.no-enabled",
)
OF_A_CHECKOUT = ("the_picture_has_not_aged", "test_two_states_of_the_code")
"""Tests that read the code of the checkout."""
ONE_THREAD = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
"""Threads that wait for each other take many times as long on a busy machine."""


def outside(python: Path, *arguments: object, cwd: Path, **variables: str) -> str:
    """What a program says that knows nothing of the checkout."""
    hidden = {"PYTHONPATH", "PYTHONHOME", "PIP_REQUIRE_VIRTUALENV"}
    environment = {name: value for name, value in os.environ.items() if name not in hidden}
    done = subprocess.run(
        [str(python), *map(str, arguments)],
        cwd=cwd,
        env={**environment, **variables, "COLUMNS": "100"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, f"{arguments}: {done.stdout[-4000:]}{done.stderr[-4000:]}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of the checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    pip = ("-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index")
    outside(Path(sys.executable), *pip, "--wheel-dir", folder, ROOT, cwd=folder)
    (path,) = folder.glob("*.whl")
    return path


def python_of(environment: Path) -> Path:
    return environment / "bin" / "python"


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a virtual environment that has the wheel, and sees this one's packages."""
    folder = tmp_path_factory.mktemp("installed")
    outside(Path(sys.executable), "-m", "venv", "--without-pip", folder / "venv", cwd=folder)
    python = python_of(folder / "venv")
    (site,) = (folder / "venv").glob("lib/python*/site-packages")
    here = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    # A path in a .pth file is searched, but the .pth files there are not read: an editable install
    # of the checkout stays out of sight.
    (site / "packages.pth").write_text("\n".join(sorted(here)) + "\n")
    pip = ("-m", "pip", "--python", python, "install", "--quiet", "--no-deps", "--no-index")
    outside(Path(sys.executable), *pip, "--ignore-installed", wheel, cwd=folder)
    return folder


def test_the_wheel_has_all_files_of_the_packages(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    kept = [
        str(path.relative_to(ROOT))
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    ]
    assert not set(kept) - names
    assert {f"{package}/py.typed" for package in PACKAGES} <= names
    assert any(name.endswith(".html") for name in kept)
    assert any(name.endswith(".json") for name in kept)
    top = {name.partition("/")[0] for name in names}
    assert {name for name in top if not name.endswith(".dist-info")} == set(PACKAGES)


def test_the_wheel_says_what_it_is(wheel: Path) -> None:
    archive = zipfile.ZipFile(wheel)
    (metadata,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
    lines = archive.read(metadata).decode().splitlines()
    assert "License-Expression: Apache-2.0" in lines
    assert "Classifier: Typing :: Typed" in lines
    assert not [line for line in lines if line.startswith("Classifier: License")]
    assert any(name.endswith("licenses/LICENSE") for name in archive.namelist())


def test_the_installed_wheel_records_and_replays(installed: Path) -> None:
    python, pglog = python_of(installed / "venv"), installed / "venv" / "bin" / "pglog"
    program = f"import {', '.join(PACKAGES)}; print({', '.join(f'{p}.__file__' for p in PACKAGES)})"
    for file in outside(python, "-c", program, cwd=installed).split():
        assert Path(file).is_relative_to(installed), file
    version = outside(
        python, "-c", "import proground_log as p; print(p.__version__)", cwd=installed
    )
    assert outside(pglog, "--version", cwd=installed) == f"proground-log {version}"

    outside(
        pglog,
        "record",
        "synthetic",
        "-o",
        "room.mcap",
        "--frames",
        "6",
        cwd=installed,
        **ONE_THREAD,
    )
    outside(pglog, "replay", "room.mcap", "-o", "run", *SMALL, cwd=installed, **ONE_THREAD)
    manifest = json.loads((installed / "run" / "manifest.json").read_text())
    assert manifest["code_version"] == version.strip()
    assert manifest["result"]["frames mapped"] == 6
    assert (installed / "run" / "map.safetensors").is_file()
    outside(pglog, "report", "run", "-o", "report.html", cwd=installed, **ONE_THREAD)
    assert "<html" in (installed / "report.html").read_text()


@pytest.mark.long
def test_the_suite_passes_on_the_wheel_with_its_own_packages(wheel: Path, tmp_path: Path) -> None:
    outside(Path(sys.executable), "-m", "venv", tmp_path / "venv", cwd=tmp_path)
    python = python_of(tmp_path / "venv")
    outside(
        *(python, "-m", "pip", "install", "--quiet"),
        *("--constraint", ROOT / "constraints.txt", f"{wheel}[test]"),
        cwd=tmp_path,
    )
    home, skipped = tmp_path / "elsewhere", shutil.ignore_patterns("__pycache__")
    for folder in ("tests", "examples"):
        shutil.copytree(ROOT / folder, home / folder, ignore=skipped)
    options = pyproject()["tool"]["pytest"]["ini_options"]
    settings = configparser.RawConfigParser()
    settings["pytest"] = {
        name: value if isinstance(value, str) else "\n" + "\n".join(value)
        for name, value in options.items()
    }
    with (home / "pytest.ini").open("w") as stream:
        settings.write(stream)
    outside(python, "-m", "pip", "check", cwd=home)
    program = f"import {', '.join(PACKAGES)}; print({', '.join(f'{p}.__file__' for p in PACKAGES)})"
    for file in outside(python, "-c", program, cwd=home).split():
        assert Path(file).is_relative_to(tmp_path / "venv"), file
    print(outside(python, "-m", "pytest", "-k", f"not {' and not '.join(OF_A_CHECKOUT)}", cwd=home))
