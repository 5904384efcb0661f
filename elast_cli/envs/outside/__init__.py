"""Environments of other packages, by their Gymnasium id: adapter, checks and calibration."""
