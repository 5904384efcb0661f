"""Shortest paths on a graph of hallucinated images (HTM)."""
