"""The files around the code say the same as the code, and as each other."""

from __future__ import annotations

import re
import subprocess
from typing import Any

import pytest
import yaml

from proground_log.version import __version__
from tests.checkout import ROOT, needs_checkout, pyproject

pytestmark = needs_checkout

WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
KINDS = {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}


def read(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def targets() -> set[str]:
    """What make can make."""
    return set(re.findall(r"^([a-z-]+):(?!=)", read("Makefile"), flags=re.MULTILINE))


def test_the_changelog_has_the_form_of_keep_a_changelog() -> None:
    heads = re.findall(r"^## (.*)$", read("CHANGELOG.md"), flags=re.MULTILINE)
    assert heads[0] == "[Unreleased]"
    assert heads[1].startswith(f"[{__version__}] - ")
    assert all(re.fullmatch(r"\[\d+\.\d+\.\d+\] - \d{4}-\d\d-\d\d", head) for head in heads[1:])
    assert set(re.findall(r"^### (.*)$", read("CHANGELOG.md"), flags=re.MULTILINE)) <= KINDS


def test_the_citation_is_of_this_version() -> None:
    citation = yaml.safe_load(read("CITATION.cff"))
    assert citation["version"] == __version__
    assert f"## [{__version__}] - {citation['date-released']}" in read("CHANGELOG.md")
    assert citation["license"] == pyproject()["project"]["license"]


def steps(workflow: dict[str, Any]) -> list[dict[str, Any]]:
    return [step for job in workflow["jobs"].values() for step in job["steps"]]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_workflows_run_make_targets_alone(path: Any) -> None:
    runs = [s["run"] for s in steps(yaml.safe_load(path.read_text())) if "run" in s]
    assert runs
    for run in runs:
        made = re.fullmatch(r'make ([a-z-]+)(?: [A-Z]+="\$[A-Z_]+")?', run)
        assert made is not None, run
        assert made[1] in targets(), run


def test_workflows_try_every_python_that_is_promised() -> None:
    promised = {
        line.rpartition(" ")[2]
        for line in pyproject()["project"]["classifiers"]
        if re.search(r":: 3\.\d+$", line)
    }
    matrix = yaml.safe_load(read(".github/workflows/test.yml"))["jobs"]["test"]["strategy"]
    assert set(matrix["matrix"]["python"]) == promised


def test_documents_and_hooks_name_targets_that_there_are() -> None:
    named = set(re.findall(r"^    make ([a-z-]+)|`make ([a-z-]+)", read("CONTRIBUTING.md"), re.M))
    named |= set(re.findall(r"^    make ([a-z-]+)|`make ([a-z-]+)", read("README.md"), re.M))
    assert {one or other for one, other in named} <= targets()
    hooks = yaml.safe_load(read(".pre-commit-config.yaml"))["repos"][0]["hooks"]
    assert {hook["entry"].removeprefix("make ") for hook in hooks} <= targets()


@pytest.mark.parametrize(("tag", "is_right"), [(f"v{__version__}", True), ("v0.0.1", False)])
def test_a_tag_that_is_not_the_version_is_refused(tag: str, is_right: bool) -> None:
    command = ["make", "check-tag", f"TAG={tag}"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, check=False)
    assert (done.returncode == 0) is is_right


@pytest.mark.parametrize("name", ["bug", "format"])
def test_issue_forms_have_what_github_asks_for(name: str) -> None:
    form = yaml.safe_load(read(f".github/ISSUE_TEMPLATE/{name}.yml"))
    assert {"name", "description", "body"} <= form.keys()
    inputs = [part for part in form["body"] if part["type"] != "markdown"]
    assert all(part["attributes"]["label"] for part in inputs)
    assert len({part["id"] for part in inputs}) == len(inputs)
