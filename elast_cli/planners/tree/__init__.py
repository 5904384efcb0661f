"""Tree search: grow, rewire, reuse (Sec. 4.3)."""
