"""Goal-conditioned implicit Q-learning on latents."""
