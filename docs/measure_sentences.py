"""Words a sentence in the documentation: python docs/measure_sentences.py [PAGE.md ...].

Prose and list items count. Code, headings, tables, figures' captions and links' targets do not.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
SECTIONS = ("tutorial", "how-to", "reference", "explanation")
MOST_WORDS = 30  # of any sentence
MOST_ON_AVERAGE = 18

_FENCE = re.compile(r"^ *```.*?^ *```$", re.MULTILINE | re.DOTALL)
_SPAN = re.compile(r"`[^`]*`")
_LINK = re.compile(r"!?\[([^\]]*)\]\([^)\s]*\)")
_ITEM = re.compile(r"^ *(?:[-*+]|\d+\.) +")
_END = re.compile(r"(?<=[.!?])(?<!e\.g\.)(?<!i\.e\.)(?<!Eq\.)(?<!Sec\.)(?<!Fig\.)[)\"*_]*\s+(?=\S)")
_WORD = re.compile(r"\w[\w'.,/−-]*")


def pages() -> list[Path]:
    """What is measured: the front pages, and those of the four sections."""
    found = [page for name in SECTIONS for page in (ROOT / "docs" / name).rglob("*.md")]
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "docs/index.md", *sorted(found)]


def sentences(text: str) -> list[str]:
    """The sentences of a page in Markdown."""
    return [sentence for block in _blocks(text) for sentence in _END.split(block) if sentence]


def words(sentence: str) -> int:
    """How many words a sentence has; a code span is one, symbols are none."""
    return len(_WORD.findall(sentence))


def _blocks(text: str) -> Iterator[str]:
    """Paragraphs and list items, each on one line."""
    block: list[str] = []
    code = False
    for line in [*_FENCE.sub("", text).splitlines(), ""]:
        plain = _LINK.sub(r"\1", _SPAN.sub("code", line)).strip()
        code = line.startswith("    ") and (code or not block)
        skipped = not plain or code or plain[0] in "|#<" or set(plain) <= set("-=")
        if skipped or _ITEM.match(line):
            if block:
                yield " ".join(block)
            block = []
        if not skipped:
            block.append(_ITEM.sub("", plain))


def main(names: list[str]) -> None:
    """Print a line a page: sentences, mean, longest, and those over the bound."""
    for page in [Path(name).resolve() for name in names] or pages():
        found = sentences(page.read_text(encoding="utf-8"))
        lengths = [words(sentence) for sentence in found] or [0]
        mean = sum(lengths) / len(lengths)
        name = page.relative_to(ROOT)
        sys.stdout.write(f"{name}: {len(found)} sentences, {mean:.1f} words, {max(lengths)} most\n")
        for sentence, length in zip(found, lengths, strict=False):
            if length > MOST_WORDS:
                sys.stdout.write(f"    {length}: {sentence}\n")


if __name__ == "__main__":
    main(sys.argv[1:])
