"""Context autoencoder."""
