"""elast: reach goals given as images by planning with expansive trees in a learned latent space."""

__version__ = "0.1.0"
