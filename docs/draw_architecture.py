"""Draws docs/images/architecture.svg from the imports of the code: `make architecture`.

A row is a layer of the import contract in pyproject.toml, a box a package of it with the first
sentence of its docstring, a line an import that no longer way of imports stands for. What lies
below the logs is one box. A test draws it again, so that it cannot age.
"""

from __future__ import annotations

import ast
import textwrap
import tomllib
from html import escape
from pathlib import Path

import grimp
import networkx as nx

ROOT = Path(__file__).parents[1]
PICTURE = ROOT / "docs" / "images" / "architecture.svg"
WIDTH, BOX_WIDTH, BOX_HEIGHT, ROW = 1180, 330, 62, 94
LOWEST = "proground_log.log"
"""The last package with a box of its own."""
FOUNDATIONS = "What all of the above are made of: each a module, each with its layer."
INK, LINE, PAPER, FILL, EDGE = "#1b1f24", "#9aa4b2", "#ffffff", "#f3f6fa", "#4c7dbf"


def layers() -> list[list[str]]:
    """The packages of each layer of the first contract, from the top down."""
    content = tomllib.loads((ROOT / "pyproject.toml").read_text())
    contract = content["tool"]["importlinter"]["contracts"][0]
    return [[name.strip() for name in row.split("|")] for row in contract["layers"]]


def rooms() -> tuple[list[list[str]], dict[str, str]]:
    """The boxes of each row, and the box that each package is in."""
    rows = layers()
    last = next(n for n, row in enumerate(rows) if LOWEST in row)
    below = [package for row in rows[last + 1 :] for package in row]
    box = ", ".join(package.removeprefix("proground_log.") for package in below)
    upper = rows[: last + 1]
    return [*upper, [box]], {p: p for row in upper for p in row} | dict.fromkeys(below, box)


def imports(box_of: dict[str, str]) -> list[tuple[str, str]]:
    """Which box imports which, without those that a way over others stands for."""
    packages = list(box_of)
    roots = sorted({package.split(".")[0] for package in packages})
    graph = grimp.build_graph(*roots)
    drawn: nx.DiGraph[str] = nx.DiGraph()
    drawn.add_nodes_from(box_of.values())

    def package_of(module: str) -> str | None:
        above = [p for p in packages if module == p or module.startswith(f"{p}.")]
        return max(above, key=len, default=None)

    for module in sorted(graph.modules):
        importer = package_of(module)
        for found in sorted(graph.find_modules_directly_imported_by(module)):
            imported = package_of(found)
            if importer and imported and box_of[importer] != box_of[imported]:
                drawn.add_edge(box_of[importer], box_of[imported])
    return sorted(nx.transitive_reduction(drawn).edges)


def sentence(package: str) -> str:
    """The first sentence of a package's or module's docstring."""
    path = ROOT / package.replace(".", "/")
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    text = (ast.get_docstring(ast.parse(file.read_text())) or "").split("\n\n")[0]
    return " ".join(text.split())


def draw() -> str:
    """The picture as SVG."""
    rows, box_of = rooms()
    middles = {}
    for number, row in enumerate(rows):
        for place, package in enumerate(row):
            x = WIDTH * (place + 1) / (len(row) + 1)
            middles[package] = (x, 20 + ROW * number + BOX_HEIGHT / 2)
    width = {box: BOX_WIDTH * (3 if "," in box else 1) for row in rows for box in row}
    height = 20 + ROW * len(rows)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" '
        'font-family="system-ui, sans-serif">',
        f'<rect width="{WIDTH}" height="{height}" fill="{PAPER}"/>',
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" '
        'markerHeight="7" orient="auto">'
        f'<path d="M0,0 L8,4 L0,8 Z" fill="{LINE}"/></marker></defs>',
    ]
    for importer, imported in imports(box_of):
        (x1, y1), (x2, y2) = middles[importer], middles[imported]
        y1, y2 = y1 + BOX_HEIGHT / 2, y2 - BOX_HEIGHT / 2
        # What passes other rows goes round them.
        rows_between = round((y2 - y1) / ROW)
        side = 1 if x1 + x2 > WIDTH else -1
        aside = side * (240 + 25 * rows_between) if rows_between else 0
        bend = (y2 - y1) / 2
        parts.append(
            f'<path d="M{x1:.0f},{y1:.0f} C{x1 + aside:.0f},{y1 + bend:.0f} '
            f'{x2 + aside:.0f},{y2 - bend:.0f} {x2:.0f},{y2:.0f}" fill="none" '
            f'stroke="{LINE}" stroke-width="1.4" marker-end="url(#tip)"/>'
        )
    for package, (x, y) in middles.items():
        left, top = x - width[package] / 2, y - BOX_HEIGHT / 2
        parts.append(
            f'<rect x="{left:.0f}" y="{top:.0f}" width="{width[package]:.0f}" '
            f'height="{BOX_HEIGHT}" rx="7" fill="{FILL}" stroke="{EDGE}"/>'
        )
        title = escape(package.removeprefix("proground_log."))
        parts.append(
            f'<text x="{x:.0f}" y="{top + 20:.0f}" text-anchor="middle" font-size="15" '
            f'font-weight="600" fill="{INK}">{title}</text>'
        )
        words = FOUNDATIONS if "," in package else sentence(package)
        lines = textwrap.wrap(words, int(width[package] / 6.2))[:2]
        for line, words in enumerate(lines):
            parts.append(
                f'<text x="{x:.0f}" y="{top + 37 + 14 * line:.0f}" text-anchor="middle" '
                f'font-size="11" fill="{INK}">{escape(words)}</text>'
            )
    return "\n".join([*parts, "</svg>", ""])


if __name__ == "__main__":
    PICTURE.write_text(draw())
    print(PICTURE.relative_to(ROOT))
