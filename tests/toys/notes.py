"""Progress that remembers."""

from __future__ import annotations

from elast_cli.progress import Silent


class Notes(Silent):
    """Progress that remembers what was said."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def note(self, text: str) -> None:
        """Remember one line."""
        self.said.append(text)
