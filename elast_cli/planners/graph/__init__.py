"""Shortest paths on a map of the data, whose edges are tested lazily."""
