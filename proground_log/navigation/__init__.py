"""From a map to ways across its floor: free space, Voronoi graph, planner (paper, Sec. 5.3)."""
