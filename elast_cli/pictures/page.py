"""A page of results in one HTML file: no script, and nothing from another server."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jinja2 import Template

TEMPLATE = "page.html"
_QUALITY, _EFFORT = 60, 4  # of WebP
_WIDTH = 360  # pixels of a film, at most


def page(content: Mapping[str, Any]) -> str:
    """The page of plain data; all text is escaped."""
    return _template().render(content) + "\n"


@cache
def _template() -> Template:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader = PackageLoader("elast_cli.pictures", "")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    return environment.get_template(TEMPLATE)


def film(animation: Path) -> str:
    """An animated GIF as a `data:` address of a smaller WebP.

    Raises:
        ValueError: it is no picture.
    """
    from PIL import Image, ImageSequence, UnidentifiedImageError

    try:
        with Image.open(animation, formats=["GIF"]) as picture:
            frames = [_narrowed(frame) for frame in ImageSequence.Iterator(picture)]
            pauses = [int(frame.info.get("duration", 100)) for frame in frames]
    except (UnidentifiedImageError, Image.DecompressionBombError, EOFError, SyntaxError) as reason:
        raise ValueError(f"{animation.name}: {reason}") from None
    out = io.BytesIO()
    settings: dict[str, Any] = {"quality": _QUALITY, "method": _EFFORT, "loop": 0}
    frames[0].save(
        out, "WEBP", save_all=True, append_images=frames[1:], duration=pauses, **settings
    )
    return _address("image/webp", out.getvalue())


def picture(path: Path) -> str:
    """A PNG as a `data:` address."""
    return _address("image/png", path.read_bytes())


def _narrowed(frame: Any) -> Any:
    """A frame in colours, at most `_WIDTH` wide."""
    shown = frame.convert("RGB")
    shown.info["duration"] = frame.info.get("duration", 100)
    if shown.width <= _WIDTH:
        return shown
    small = shown.resize((_WIDTH, round(shown.height * _WIDTH / shown.width)))
    small.info["duration"] = shown.info["duration"]
    return small


def _address(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"
