"""Transition density ψ."""
