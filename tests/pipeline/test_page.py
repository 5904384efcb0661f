"""`elast report`: evaluations as one HTML page that needs nothing but itself."""

from __future__ import annotations

import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from elast_cli.errors import DataError
from elast_cli.evaluation.paper import paper_success
from elast_cli.pictures.page import film, page
from elast_cli.stages.page import document
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store
from tests.toys.pipeline import run_in

HOSTILE = "</pre><script src=https://evil.example>\"'&"


class Parsed(HTMLParser):
    """Tags that are open, texts of cells, and addresses of what the page loads."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.cells: list[list[str]] = []
        self.loaded: list[str] = []
        self.tags: set[str] = set()
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.loaded += [str(value) for name, value in attrs if name in ("src", "srcset", "href")]
        if tag == "tr":
            self.cells.append([])
        if tag in ("td", "th"):
            self.cells[-1].append("")
        if tag not in ("meta", "img", "source", "rect", "path"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in ("td", "th", "strong"):
            self.cells[-1][-1] += data.strip()


def test_the_page_has_every_evaluation_and_loads_nothing(one: Path, tmp_path: Path) -> None:
    at = tmp_path / "page.html"
    assert run_in(one, ["report", "--output", str(at)]) == 0
    text = at.read_text(encoding="utf-8")
    found = Parsed(text)
    assert found.open == []
    assert "script" not in found.tags
    assert found.loaded  # films
    assert all(address.startswith("data:image/") for address in found.loaded)
    assert not re.search("https?:", re.sub(r"data:[^\"]*", "", text))
    results = json.loads((one / "artifacts/block-s/report/v1/results.json").read_text())
    rates = {r["method"]: r for r in results["overall"] if r["train_seed"] is None}
    rows = {cells[0]: cells for cells in found.cells if cells[0] in rates}
    assert rows.keys() == rates.keys()
    for method, cells in rows.items():
        assert cells[1] == f"{rates[method]['pc_success']:.1f}"
        assert cells[-1] == "2"
        assert cells[4] == f"{paper_success(method, 'block-s', 'hard'):.0f}"
    assert "block-s/dataset/v1" in text
    assert "elast run --env block-s --preset quick --methods elast,cpc-cem,random" in text


def test_the_bytes_of_a_page_repeat(one: Path, tmp_path: Path) -> None:
    for name in "ab":
        assert run_in(one, ["report", "block-s/report/v1", "-o", str(tmp_path / name)]) == 0
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_report_stands_for_its_evaluations(one: Path) -> None:
    store = Store(one)
    parents = [
        parent.ref for parent in store.manifest(Ref.parse("block-s/report/v1")).parents.values()
    ]
    assert document(store, ["block-s/report/v1"]) == document(store, parents)
    assert document(store, parents)["evaluations"] == 3


def test_hostile_texts_are_escaped(one: Path) -> None:
    content: dict[str, Any] = document(Store(one), [])
    content["title"] = HOSTILE
    task = content["tasks"][0]
    task |= {"command": HOSTILE, "about": HOSTILE, "notes": [HOSTILE], "caption": HOSTILE}
    task["lines"][0]["method"] = HOSTILE
    task["films"][0]["caption"] = HOSTILE
    task["lineage"][0]["text"] = HOSTILE
    text = page(content)
    found = Parsed(text)
    assert found.open == []
    assert "script" not in found.tags
    assert "<script" not in text
    assert all(address.startswith("data:image/") for address in found.loaded)


def test_a_damaged_film_is_no_film(one: Path, tmp_path: Path) -> None:
    path = tmp_path / "film.gif"
    path.write_bytes(b"GIF89a, or so it says")
    with pytest.raises(ValueError, match=r"film\.gif"):
        film(path)
    shutil.copytree(one, tmp_path / "home")
    changed = next((tmp_path / "home/artifacts/block-s/eval").glob("*/*.gif"))
    changed.write_bytes(path.read_bytes())
    with pytest.raises(DataError, match="bytes, not"):
        document(Store(tmp_path / "home"), [])


@pytest.mark.parametrize(
    ("refs", "code", "says"),
    [
        (["block-s/encoder/v1"], 2, "report takes eval, report and plan refs"),
        (["block-s/eval/v99"], 66, "block-s/eval/v99"),
        (["nonsense"], 2, "nonsense"),
    ],
)
def test_what_is_no_evaluation_is_one_line(
    one: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    refs: list[str],
    code: int,
    says: str,
) -> None:
    assert run_in(one, ["report", *refs, "-o", str(tmp_path / "page.html")]) == code
    said = capsys.readouterr().err
    assert says in said
    assert said.count("\n") == 1
    assert not (tmp_path / "page.html").exists()


def test_a_store_without_evaluations_names_the_command(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_in(home, ["report"]) == 66
    assert "run: elast run" in capsys.readouterr().err
