"""What the flat worlds share: rasters, rectangles, shortest paths."""
