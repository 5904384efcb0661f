"""Trained models as functions on arrays."""
