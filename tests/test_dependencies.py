"""What is imported is declared, what is declared is imported, and the floors are what is tested."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

from tests.checkout import ROOT, needs_checkout, pyproject

pytestmark = [needs_checkout, pytest.mark.slow]

PRODUCT = ("pglog", "proground_log", "recorders", "replay")
OTHERS = ("benchmarks", "examples", "tests")
IMPORT_NAMES = {
    "mcap-ros2-support": "mcap_ros2",
    "opencv-python-headless": "cv2",
    "pillow": "PIL",
    "pyyaml": "yaml",
    "rerun-sdk": "rerun",
    "scikit-image": "skimage",
    "universal-pathlib": "upath",
}
"""Of packages that are not imported by the name they are installed by."""
UNIMPORTED = {
    "aiohttp": "fsspec imports it for https://",
    "gcsfs": "fsspec imports it for gs://",
    "s3fs": "fsspec imports it for s3://",
    "hatchling": "pip builds the wheel with it",
    "pip": "builds and installs the wheel",
}
"""Packages that another one imports, or that are run."""
TOOLS = {"build", "import-linter", "mypy", "proground-log", "ruff", "scipy-stubs"}
"""What `dev` adds to `test`: run by make, imported by nobody."""
BY_NAME = ("import_module", "find_spec", "importorskip")


def name_of(requirement: str) -> str:
    """`scipy` of `scipy>=1.13`."""
    found = re.match(r"[A-Za-z0-9._-]+", requirement)
    assert found is not None
    return found.group().lower()


def floor_of(requirement: str) -> str | None:
    """`1.13` of `scipy>=1.13,<2`."""
    found = re.search(r">=([0-9.]+)", requirement)
    return found and found.group(1)


def import_name(package: str) -> str:
    return IMPORT_NAMES.get(package, package.replace("-", "_"))


def required() -> list[str]:
    requirements: list[str] = pyproject()["project"]["dependencies"]
    return requirements


def optional() -> list[str]:
    """What the extras for users bring."""
    extras: dict[str, list[str]] = pyproject()["project"]["optional-dependencies"]
    return [r for name in extras if name not in ("test", "dev") for r in extras[name]]


def extra(name: str) -> list[str]:
    """What an extra brings."""
    requirements: list[str] = pyproject()["project"]["optional-dependencies"][name]
    return requirements


def import_names(requirements: Iterable[str]) -> set[str]:
    return {import_name(name_of(requirement)) for requirement in requirements}


def imports(folder: str) -> Iterator[tuple[str, Path, bool]]:
    """Every module that a folder's files import, also by `import_module("name")`.

    With it come the file, and whether importing the file takes it: it stands in no function or try.
    """
    for path in sorted((ROOT / folder).rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            match node:
                case ast.Import():
                    names = [alias.name for alias in node.names]
                case ast.ImportFrom(level=0, module=str(module)):
                    names = [module]
                case ast.Call(args=[ast.Constant(value=str(module)), *_]) if (
                    ast.unparse(node.func).rpartition(".")[2] in BY_NAME
                ):
                    names = [module]
                case _:
                    continue
            yield from ((name.partition(".")[0], path, node in tree.body) for name in names)


def third_party(folder: str) -> dict[str, list[str]]:
    """By module that is neither Python's nor the repository's, the files that import it."""
    beside = {path.stem for path in (ROOT / "tests").rglob("*.py")}  # `import tiny_yolo`
    ours = {*PRODUCT, *OTHERS, *(beside if folder == "tests" else ())}
    found: dict[str, list[str]] = {}
    for module, path, _ in imports(folder):
        if module not in ours and module not in sys.stdlib_module_names:
            found.setdefault(module, []).append(str(path.relative_to(ROOT)))
    return found


@pytest.mark.parametrize("folder", [*PRODUCT, "benchmarks", "examples"])
def test_what_the_product_imports_is_declared(folder: str) -> None:
    declared = import_names([*required(), *optional()])
    assert not {m: where for m, where in third_party(folder).items() if m not in declared}


def test_what_the_tests_import_is_declared() -> None:
    declared = import_names([*required(), *optional(), *extra("test")])
    assert not {m: where for m, where in third_party("tests").items() if m not in declared}


def test_what_is_declared_is_imported() -> None:
    imported = {module for folder in PRODUCT for module in third_party(folder)}
    declared = {name_of(requirement) for requirement in [*required(), *optional()]}
    assert not {n for n in declared - UNIMPORTED.keys() if import_name(n) not in imported}


def test_what_the_tests_declare_is_used() -> None:
    imported = {module for folder in (*PRODUCT, "tests") for module in third_party(folder)}
    tests = {name_of(requirement) for requirement in extra("test")} - UNIMPORTED.keys()
    assert not {name for name in tests if import_name(name) not in imported}
    assert {name_of(requirement) for requirement in extra("dev")} == TOOLS


def test_an_extra_is_imported_only_when_it_is_needed() -> None:
    extras = import_names(optional()) - import_names(required())
    for folder in PRODUCT:
        for module, path, at_import in imports(folder):
            assert not (module in extras and at_import), f"without its extra, {path} fails"


def pins(file: str) -> dict[str, str]:
    """By package the version that a constraints file wants."""
    lines = (ROOT / file).read_text(encoding="utf-8").splitlines()
    found = [line.partition("==") for line in lines if line and not line.startswith("#")]
    return {name: version for name, _, version in found}


def test_every_package_has_a_floor_and_the_oldest_constraints_pin_it() -> None:
    pinned = pins("constraints-oldest.txt")
    for requirement in [*required(), *optional()]:
        floor, pin = floor_of(requirement), pinned.get(name_of(requirement))
        assert floor is not None, requirement
        assert pin is not None, f"constraints-oldest.txt does not pin {requirement}"
        # The floor 5.0 is 5.0.0, or 5.0.0.93 where that is the first there is of 5.0.
        assert f"{pin}.".startswith(f"{floor}."), f"{requirement}, pinned is {pin}"


def test_both_constraints_files_pin_every_package_that_is_installed() -> None:
    needed = {name_of(r) for r in [*required(), *extra("test")]} - {"pip"}
    assert not needed - pins("constraints-oldest.txt").keys()
    tools = {name_of(r) for r in extra("dev")} - {"proground-log"}
    assert not (needed | tools) - pins("constraints.txt").keys()
