"""Recurrent state-space model of PlaNet (Hafner et al. 2019)."""
