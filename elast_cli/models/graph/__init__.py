"""Training states as a map of the latent space."""
