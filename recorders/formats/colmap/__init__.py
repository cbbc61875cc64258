"""COLMAP reconstructions: model, lenses, depth and scale."""
