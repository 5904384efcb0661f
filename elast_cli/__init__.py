"""elast: reach goals given as images by planning with expansive trees in a learned latent space.

In Python, `import elast_cli as elast` gives `elast.load`, which loads a trained method as an
`Agent`. docs/reference/python-api.md has an example.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from elast_cli.agent import Agent, Outcome, Plan, load, read_image

__all__ = ["Agent", "Outcome", "Plan", "load", "read_image"]
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """The names of the Python API, imported when they are first asked for."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from elast_cli import agent

    return getattr(agent, name)
