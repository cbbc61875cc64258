from __future__ import annotations

from pathlib import Path

import pytest

from tests.writers.small_source import SmallSource, write_log


@pytest.fixture(scope="module")
def small_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("small") / "a.mcap"
    return write_log(path, SmallSource(5, with_labels=True))
