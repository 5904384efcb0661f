"""Goal-conditioned behaviour cloning on latents."""
