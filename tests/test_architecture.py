"""The picture of the house is that of its imports, and no files import each other in a circle."""

from __future__ import annotations

import runpy
from pathlib import Path

import grimp
import networkx as nx

DRAW = Path(__file__).parents[1] / "docs" / "draw_architecture.py"
PACKAGES = ("pglog", "proground_log", "recorders", "replay")


def test_the_picture_has_not_aged() -> None:
    script = runpy.run_path(str(DRAW))
    assert script["PICTURE"].read_text() == script["draw"](), "run `make architecture`"


def test_no_files_import_each_other_in_a_circle() -> None:
    graph = grimp.build_graph(*PACKAGES)
    imports = nx.DiGraph(
        (importer, imported)
        for importer in graph.modules
        for imported in graph.find_modules_directly_imported_by(importer)
    )
    circles = [sorted(part) for part in nx.strongly_connected_components(imports) if len(part) > 1]
    assert circles == []
