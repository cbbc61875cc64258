"""The Voronoi graph of rooms whose graph one can draw by hand."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest

from proground_log.navigation.voronoi import voronoi_cells, voronoi_graph, way_on_graph
from tests.navigation.scenes import Box, plan_of, scene

PILLAR: Box = ((1.5, 1.5, 0.0), (2.5, 2.5, 0.9))


def graph_of(size_m: tuple[float, float], *boxes: Box, radius_m: float = 0.18):  # type: ignore[no-untyped-def]
    plan = plan_of(scene(size_m, boxes))
    return plan, voronoi_graph(plan, voronoi_cells(plan, radius_m))


def test_a_corridor_has_its_middle_line() -> None:
    plan, graph = graph_of((6.0, 1.0))
    assert nx.number_connected_components(graph) == 1
    for _, _, edge in graph.edges(data=True):
        middle_m = plan.centres(edge["cells"])
        inner = middle_m[(middle_m[:, 0] > 0.6) & (middle_m[:, 0] < 5.4)]
        assert np.abs(inner[:, 1] - 0.5).max() <= plan.cell_m
    total_m = sum(edge["length_m"] for _, _, edge in graph.edges(data=True))
    assert 4.8 < total_m < 6.5


def test_a_pillar_has_a_ring_round_it() -> None:
    _, graph = graph_of((4.0, 4.0), PILLAR)
    assert graph.number_of_edges() - graph.number_of_nodes() + 1 == 1
    _, empty = graph_of((4.0, 4.0))
    assert empty.number_of_edges() - empty.number_of_nodes() + 1 == 0


def test_a_crossing_is_a_junction_of_four_ways() -> None:
    corners: list[Box] = [
        ((x, y, 0.0), (x + 2.0, y + 2.0, 0.9)) for x in (0.0, 3.0) for y in (0.0, 3.0)
    ]
    _, graph = graph_of((5.0, 5.0), *corners)
    junctions = [node for node, degree in graph.degree() if degree > 2]
    middle_m = [graph.nodes[node]["position_m"] for node in junctions]
    np.testing.assert_allclose(middle_m, np.full((len(junctions), 2), 2.5), atol=0.2)
    assert sum(degree == 1 for _, degree in graph.degree()) == 4


def test_the_graph_keeps_the_clearance_and_says_so() -> None:
    plan, graph = graph_of((4.0, 4.0), PILLAR, radius_m=0.3)
    for a, b, edge in graph.edges(data=True):
        assert {tuple(edge["cells"][0]), tuple(edge["cells"][-1])} == {a, b}
        clearance_m = plan.clearance_m[tuple(edge["cells"].T)]
        assert clearance_m.min() == edge["clearance_m"] >= 0.3
        steps = np.abs(np.diff(edge["cells"], axis=0))
        assert steps.max() == 1
        length_m = np.linalg.norm(np.diff(plan.centres(edge["cells"]), axis=0), axis=1).sum()
        assert edge["length_m"] == pytest.approx(length_m)


def test_a_gap_that_is_too_narrow_parts_the_graph() -> None:
    door: list[Box] = [((2.0, 0.0, 0.0), (2.1, 1.2, 0.9)), ((2.0, 1.8, 0.0), (2.1, 3.0, 0.9))]
    for radius_m, parts in ((0.18, 1), (0.35, 2)):
        _, graph = graph_of((4.0, 3.0), *door, radius_m=radius_m)
        assert nx.number_connected_components(graph) == parts


def test_a_way_on_the_graph_goes_from_cell_to_cell_the_shorter_way_round() -> None:
    plan = plan_of(scene((4.0, 4.0), [((1.0, 1.5, 0.0), (2.5, 2.5, 0.9))]))
    cells = voronoi_cells(plan, 0.18)
    places = sorted(cells)
    start, goal = places[0], places[len(places) // 3]
    way = way_on_graph(voronoi_graph(plan, cells, (start, goal)), start, goal)
    assert way is not None
    assert tuple(way[0]) == start
    assert tuple(way[-1]) == goal
    assert np.abs(np.diff(way, axis=0)).max() == 1
    length_m = np.linalg.norm(np.diff(plan.centres(way), axis=0), axis=1).sum()
    expected_m = nx.dijkstra_path_length(cells, start, goal, weight="length_m")
    assert length_m == pytest.approx(expected_m)
