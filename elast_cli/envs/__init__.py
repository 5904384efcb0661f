"""Environments: the table, scenarios, and one folder a family.

Importing this package registers the ids with gymnasium, so that
`gymnasium.make("elast_cli.envs:elast/Cable-v0")` works.
"""

from elast_cli.envs import registry

__all__ = ["registry"]
