"""What the flat workspaces share: rasters, rectangles, shortest paths."""
