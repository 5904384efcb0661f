"""Engines: where the tasks of a stage run. `base.Engine` is what the stages ask for."""
