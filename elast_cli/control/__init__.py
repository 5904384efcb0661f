"""Controllers: from frames to actions, and the episode loop."""
