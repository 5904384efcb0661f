"""Tests of the Sawyer family."""
