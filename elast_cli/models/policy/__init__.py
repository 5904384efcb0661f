"""Local policy π."""
