"""Conditional variational autoencoder of single frames."""
