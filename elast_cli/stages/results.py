"""Results of evaluations and reports, read back and compared."""

from __future__ import annotations

import json
from pathlib import Path

from elast_cli.errors import DataError, UsageError
from elast_cli.evaluation.comparison import Comparison, compare
from elast_cli.evaluation.rows import Results
from elast_cli.evaluation.summary import parse_results
from elast_cli.evaluation.tables import success_notes
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store

RESULTS_FILE = "results.json"
WORLD = ("env", "levels", "domain")  # settings in which equal scenarios are equal
_MOST_BYTES = 256 << 20  # of a results file
_BYTES_A_BRACKET = 64  # results have one list or object in some hundred bytes


def comparison(store: Store, text_a: str, text_b: str) -> list[Comparison]:
    """Paired differences of two evaluations or reports, B minus A.

    Raises:
        DataError: their environments differ, so equal numbers are not equal scenarios.
    """
    results = [read_results(store, Ref.parse(text)) for text in (text_a, text_b)]
    for key in WORLD:
        a, b = (found.settings.get(key) for found in results)
        if key == "levels" and isinstance(a, dict) and isinstance(b, dict):
            shared = a.keys() & b.keys()
            a, b = ({level: steps[level] for level in shared} for steps in (a, b))
        if a is not None and b is not None and a != b:
            raise DataError(
                f"{text_a} and {text_b} were made with different environment settings: "
                f"{key} {_json(a)} against {_json(b)}"
            )
    return compare(*(found.per_episode for found in results))


def success_of(store: Store, *refs: str) -> list[str]:
    """What decides success in evaluations or reports, a line for each outside environment."""
    return success_notes(read_results(store, Ref.parse(text)).settings for text in refs)


def _json(value: object) -> str:
    return json.dumps(value, sort_keys=True)[:200]


def read_results(store: Store, ref: Ref) -> Results:
    """The results of an evaluation or a report.

    Raises:
        UsageError: the artifact is of another kind.
        DataError: its results are damaged.
    """
    if ref.kind not in ("eval", "report"):
        store.manifest(ref)  # says so if it does not exist at all
        raise UsageError(f"{ref}: kind {ref.kind}; compare takes eval or report refs: elast ls")
    return parse_results(_read_json(store.file(ref, RESULTS_FILE), ref))


def texts(value: object) -> list[str]:
    """The texts in a list that a results file holds, or none."""
    return [str(item) for item in value] if isinstance(value, list) else []


def _read_json(path: Path, ref: Ref) -> object:
    if path.stat().st_size > _MOST_BYTES:
        raise DataError(f"{ref}: {path.name} is larger than {_MOST_BYTES} bytes")
    content = path.read_bytes()
    if content.count(b"[") + content.count(b"{") > 1000 + len(content) // _BYTES_A_BRACKET:
        raise DataError(f"{ref}: {path.name}: more lists and objects than results have")
    try:
        return json.loads(content)
    except (ValueError, RecursionError) as reason:
        raise DataError(f"{ref}: {path.name}: not JSON ({reason})") from None
