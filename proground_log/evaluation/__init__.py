"""How good a map is: views, mesh, labels, objects."""
