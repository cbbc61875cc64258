from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.fuzz.mutations import of_bytes, of_words

INPUTS = 25


@pytest.mark.parametrize("change", [of_bytes, of_words])
def test_changes_depend_on_the_seed_alone(change: object) -> None:
    data = b'{"a": [1, 2.5, "three"]}' * 9
    first, again, other = (
        [change(data, np.random.default_rng([seed, n])) for n in range(50)]  # type: ignore[operator]
        for seed in (1, 1, 2)
    )
    assert first == again != other


@pytest.mark.slow
def test_hostile_files_give_results_or_errors(tmp_path: Path) -> None:
    """A few inputs of every target; `make fuzz` takes many more."""
    for package in ("lzfse", "rosbags"):
        pytest.importorskip(package)
    # A process of its own: it forks, and limits the memory of its children.
    ran = subprocess.run(
        [sys.executable, "-m", "tests.fuzz", f"--inputs={INPUTS}", f"--findings={tmp_path}"],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "recover" in ran.stdout
