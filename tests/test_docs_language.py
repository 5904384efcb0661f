"""Documentation is easy to read: short sentences, short front pages, plain words."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
MEASURE: dict[str, Any] = runpy.run_path(str(ROOT / "docs/measure_sentences.py"))
sentences, words = MEASURE["sentences"], MEASURE["words"]
PAGES: list[Path] = MEASURE["pages"]()
ODD = re.compile(r"\b(whoever|lent|barred|had not|could not be had)\b", re.IGNORECASE)


def found(page: Path) -> list[str]:
    """The sentences of a page."""
    listed: list[str] = sentences(page.read_text(encoding="utf-8"))
    return listed


def test_sentences_are_found_in_paragraphs_and_lists_and_nowhere_else() -> None:
    page = """# A title. It is none

One claim of `code. in it`. Eq. 4 says so,
on two lines ([a link](to/a.md)).

- An item.
- Another
  item.

| a table. | with. |

    a command. of words

```python
x = "A sentence."
```
"""
    assert sentences(page) == [
        "One claim of code.",
        "Eq. 4 says so, on two lines (a link).",
        "An item.",
        "Another item.",
    ]
    assert words("Success is 97.5 % [94, 99] of z' in steps/s.") == 9


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_no_sentence_is_long(page: Path) -> None:
    assert not [s for s in found(page) if words(s) > MEASURE["MOST_WORDS"]]


@pytest.mark.parametrize("section", ["README.md", *(f"docs/{s}" for s in MEASURE["SECTIONS"])])
def test_sentences_of_a_section_are_short_on_average(section: str) -> None:
    of_section = [p for p in PAGES if str(p.relative_to(ROOT)).startswith(section)]
    lengths = [words(s) for page in of_section for s in found(page)]
    assert sum(lengths) / len(lengths) <= MEASURE["MOST_ON_AVERAGE"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_words_are_plain(page: Path) -> None:
    assert not [s for s in found(page) if ODD.search(s)]


def test_the_front_pages_are_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= 120
    assert len((ROOT / "docs/explanation/method.md").read_text().split()) <= 1200
