"""Dynamics ensemble H_f and its support."""
