"""The generalised Voronoi graph of a floor plan: the ways that keep to the middle.

A point of free space is on it if it is equally far from two obstacles or more. That is the skeleton
of the free space; and the skeleton of the places where a robot of a radius fits is the part of it
with at least that clearance, so that it is drawn of those at once.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import networkx as nx
import numpy as np
from skimage.morphology import skeletonize

from proground_log.navigation.floor_plan import FloorPlan
from proground_log.navigation.grid_ways import STEPS

Cell = tuple[int, int]


def voronoi_cells(plan: FloorPlan, radius_m: float) -> nx.Graph[Cell]:
    """The skeleton, cell by cell, of where a robot of a radius fits.

    Spurs shorter than the clearance where they branch off are left out: they lead into corners.

    Returns:
        A graph whose nodes are cells, joined to those beside them, with the `length_m` from centre
        to centre.
    """
    thin = skeletonize(plan.clearance_m >= radius_m)
    cells = nx.Graph()
    cells.add_nodes_from((int(x), int(y)) for x, y in np.argwhere(thin))
    for x, y in list(cells):
        for dx, dy in STEPS:
            # Across a corner only where there is no way round it.
            if (x + dx, y + dy) in cells and not (
                dx and dy and ((x + dx, y) in cells or (x, y + dy) in cells)
            ):
                cells.add_edge((x, y), (x + dx, y + dy), length_m=plan.cell_m * np.hypot(dx, dy))
    spurs = [
        line[1:]
        for line in _lines(cells, ())
        if cells.degree(line[-1]) == 1
        and cells.degree(line[0]) > 2
        and _length_m(cells, line) < plan.clearance_m[line[0]]
    ]
    cells.remove_nodes_from(cell for spur in spurs for cell in spur)
    return cells


def voronoi_graph(
    plan: FloorPlan, cells: nx.Graph[Cell], through: Iterable[Cell] = ()
) -> nx.MultiGraph[Cell]:
    """Junctions and ends, and the lines between them.

    Args:
        plan: the floor.
        cells: what `voronoi_cells` gives.
        through: cells that become nodes though lines only pass through them.

    Returns:
        Nodes are cells, with `position_m` (x, y) on the plan and `clearance_m`; edges have their
        `cells`, int [N, 2], from one node to the other, their `length_m` and the least
        `clearance_m` on them. Two nodes may have several edges, and a ring begins where it ends.
    """
    graph = nx.MultiGraph()
    lines = _lines(cells, through)
    alone = [cell for cell in cells if not cells.degree(cell)]
    for cell in sorted({*(line[end] for line in lines for end in (0, -1)), *alone, *through}):
        x_m, y_m = plan.centres(np.array(cell))
        position_m = (float(x_m), float(y_m))
        graph.add_node(cell, position_m=position_m, clearance_m=float(plan.clearance_m[cell]))
    for line in lines:
        graph.add_edge(
            line[0],
            line[-1],
            cells=np.array(line),
            length_m=_length_m(cells, line),
            clearance_m=float(min(plan.clearance_m[cell] for cell in line)),
        )
    return graph


def way_on_graph(graph: nx.MultiGraph[Cell], start: Cell, goal: Cell) -> np.ndarray | None:
    """The cells int [N, 2] of the shortest way from node to node; None where there is none."""
    try:
        nodes = nx.dijkstra_path(graph, start, goal, weight="length_m")
    except nx.NetworkXNoPath:
        return None
    way = [np.array([start])]
    for a, b in pairwise(nodes):
        edges = graph.get_edge_data(a, b)
        line = min(edges.items(), key=lambda item: (item[1]["length_m"], item[0]))[1]["cells"]
        way.append((line if tuple(line[0]) == a else line[::-1])[1:])
    return np.concatenate(way)


def _lines(cells: nx.Graph[Cell], through: Iterable[Cell]) -> list[list[Cell]]:
    """The lines between junctions, ends and what they shall be cut at, each once."""
    joints = {cell for cell in cells if cells.degree(cell) != 2} | set(through)
    for ring in sorted(map(sorted, nx.connected_components(cells))):
        # A ring with nothing to begin at.
        if joints.isdisjoint(ring):
            joints.add(ring[0])
    lines, known = [], set()
    for joint in sorted(joints):
        for beside in sorted(cells[joint]):
            if (joint, beside) in known:
                continue
            line = [joint, beside]
            while line[-1] not in joints:
                (ahead,) = (cell for cell in cells[line[-1]] if cell != line[-2])
                line.append(ahead)
            known |= {(joint, beside), (line[-1], line[-2])}
            lines.append(line)
    # A spur runs outwards.
    return [line[::-1] if cells.degree(line[0]) == 1 else line for line in lines]


def _length_m(cells: nx.Graph[Cell], line: list[Cell]) -> float:
    return float(sum(cells[a][b]["length_m"] for a, b in pairwise(line)))
