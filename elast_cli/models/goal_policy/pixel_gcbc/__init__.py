"""Goal-conditioned behaviour cloning on images."""
