"""Datasets of episodes: their HDF5 layout, shards, and safe reading."""
