"""YAML made to do harm, and a bound on what reading it may cost."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def bounded() -> Iterator[None]:
    """No hostile file may cost more than 300 MB."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000


# ---- YAML ---------------------------------------------------------------------------------------

YAML = {
    "a python tag": (b"a: !!python/object/apply:os.system ['touch owned']", "tags are not allowed"),
    "any tag": (b"a: !secret x", "tags are not allowed"),
    "a duplicate key": (b"a: 1\na: 2", 'line 2: found duplicate key "a"'),
    "an alias": (b"a: &x [1]\nb: *x", "line 1: anchors and aliases"),
    "a billion laughs": (b"a: &a [x]\nb: &b [*a,*a]\nc: [*b,*b]", "anchors and aliases"),
    "100k brackets": (b"[" * 100_000, "nested deeper than 32"),
    "100k braces": (b"{a: " * 100_000, "nested deeper than 32"),
    "100k dashes": (b"- " * 100_000, "nested deeper than 32"),
    "500k values": (b"a: [" + b"1," * 500_000 + b"]", "more than 20000 values"),
    "NaN": (b"a: {b: .nan}", r"a\.b: nan is not a finite number"),
    "infinity": (b"a: [1, -.inf]", r"a\[1\]: -inf is not a finite number"),
    "an overflowing number": (b"a: 1e999", "a: inf is not a finite number"),
    "a huge integer": (b"a: " + b"9" * 500_000, "integer string conversion"),
    "a long integer": (b"a: 0x" + b"f" * 300_000, "more than 64 bits"),
    "bad UTF-8": (b"a: \xff\xfe", r"not UTF-8 text \(byte 3\)"),
    "a NUL": (b"a: \x00", "unacceptable character"),
    "half a surrogate pair": (b'a: "\\ud800"', "a: not valid Unicode text"),
    "a date": (b"a: 2020-01-01", "not plain data"),
    "a key that is no string": (b"1: 2", "key 1 is not a string"),
    "two documents": (b"a: 1\n---\nb: 2", "line 2: but found another document"),
    "an unclosed list": (b"a: [", "line 1"),
    "too many bytes": (b"#" * (1 << 20) + b"\n", "larger than 1048576 bytes"),
}
