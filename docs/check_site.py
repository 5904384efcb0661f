"""Refuse a site whose pages load anything from another server: python docs/check_site.py FOLDER."""

from __future__ import annotations

import re
import sys
from html.parser import HTMLParser
from pathlib import Path

LOADED = {"script": "src", "img": "src", "iframe": "src", "source": "src", "link": "href"}
IMPORTED = re.compile(r"(?:url\(|@import)\s*[\"']?((?:https?:)?//[^\"')\s]+)")


class Loads(HTMLParser):
    """Collects what a page loads from elsewhere."""

    def __init__(self) -> None:
        """Nothing yet."""
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note an address of another server; `<link rel=canonical>` and the like load nothing."""
        given = dict(attrs)
        address = given.get(LOADED.get(tag, "")) or ""
        silent = tag == "link" and given.get("rel") in ("canonical", "next", "prev")
        if re.match(r"(https?:)?//", address) and not silent:
            self.found.append(address)


def loads(file: Path) -> list[str]:
    """Addresses of other servers that an HTML or CSS file loads from."""
    text = file.read_text(encoding="utf-8")
    if file.suffix == ".css":
        return IMPORTED.findall(text)
    page = Loads()
    page.feed(text)
    return page.found


def main(folder: Path) -> int:
    """Print what is loaded from elsewhere; 1 if there is anything, or no page at all."""
    files = [*folder.rglob("*.html"), *folder.rglob("*.css")]
    found = [f"{file}: {address}" for file in files for address in loads(file)]
    sys.stderr.write("".join(f"loads from another server: {line}\n" for line in found))
    return 1 if found or not files else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
