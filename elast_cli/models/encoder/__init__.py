"""Encoder φ and its training objective."""
