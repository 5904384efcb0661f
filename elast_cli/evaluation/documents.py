"""Tables as files: CSV for programs, Markdown for people."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence

from elast_cli.evaluation.rows import OverallRow


def csv_text(rows: Sequence[Mapping[str, object]]) -> str:
    """Records of equal keys as CSV; an unknown figure is empty."""
    out = io.StringIO()
    writer = csv.DictWriter(out, fieldnames=list(rows[0]) if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()


def markdown_table(headers: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of texts in Markdown."""
    lines = [headers, ["---"] * len(headers), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def success_text(row: OverallRow) -> str:
    """Success in percent, its interval, and by seed: `98.3 [96.2, 99.3] (100 99 96)`."""
    low, high = row.ci95
    text = f"{row.pc_success:.1f} [{low:.1f}, {high:.1f}]"
    by_seed = list((row.pc_success_by_seed or {}).values())
    return f"{text} ({' '.join(f'{rate:.0f}' for rate in by_seed)})" if len(by_seed) > 1 else text


def success_record(row: OverallRow | None) -> dict[str, object]:
    """The same as fields of a record."""
    by_seed = (row.pc_success_by_seed or {}) if row else {}
    return {
        "success": row.pc_success if row else None,
        "ci95_low": row.ci95[0] if row else None,
        "ci95_high": row.ci95[1] if row else None,
        "by_seed": " ".join(f"{seed}:{rate:g}" for seed, rate in by_seed.items()),
        "steps": row.steps if row else None,
        "episodes": row.n_episodes if row else None,
    }
