"""Connectivity of hallucinated images, and the inverse model that follows them."""
