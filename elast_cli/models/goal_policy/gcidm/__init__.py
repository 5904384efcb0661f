"""Inverse dynamics over several steps, given how many remain."""
