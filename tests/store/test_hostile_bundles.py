"""Bundles made to do harm: refused within bounds in one line, and nothing is written."""

from __future__ import annotations

import os
import stat
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from zipfile import ZIP_DEFLATED

import pytest

from elast_cli.config import dump_yaml, parse_yaml
from elast_cli.errors import DataError, MissingInputError
from elast_cli.store.bundle import INDEX
from elast_cli.store.store import Store
from elast_cli.store.unbundle import MAX_MEMBERS, unpack
from tests.toys.bundles import Change, Members, bundled, named, replaced, rewrite
from tests.toys.hostile import YAML, bounded

pytestmark = pytest.mark.timeout(60)

ENCODER = "block-s/encoder/v1"


@pytest.fixture(autouse=True)
def _bounded() -> Iterator[None]:
    with bounded():
        yield


@pytest.fixture
def path(store: Store, tmp_path: Path) -> Path:
    """A sound bundle."""
    bundled(store, tmp_path / "toy.zip")
    return tmp_path / "toy.zip"


def refused(path: Path, tmp_path: Path, message: str | None = None) -> None:
    """Unpacking fails with one line, and writes nothing."""
    home = tmp_path / "victim"
    with pytest.raises(DataError, match=message) as caught:
        unpack(path, Store(home))
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    assert not home.exists()


def added(name: str) -> Change:
    return lambda found: found.append(named(name))


def compressed(found: Members) -> None:
    info, content = named(f"{ENCODER}/bomb", b"\0" * 100_000_000)
    info.compress_type = ZIP_DEFLATED
    found.append((info, content))


def special(mode: int) -> Change:
    def change(found: Members) -> None:
        info, content = named(f"{ENCODER}/content.bin", b"/etc/passwd")
        info.external_attr = mode << 16
        found[-1] = (info, content)

    return change


def twice(found: Members) -> None:
    info, content = named("x/y/v1/z")
    found += [(info, content), named("x/y/v1/z")]


def indexed(**changes: object) -> Change:
    def change(content: bytes) -> bytes:
        return dump_yaml({**parse_yaml(content, INDEX), **changes}).encode()

    return replaced(INDEX, change)


def dropped(end: str) -> Change:
    def change(found: Members) -> None:
        found[:] = [pair for pair in found if not pair[0].filename.endswith(end)]

    return change


def extra(found: Members) -> None:
    found[-1][0].extra = b"\x77\x77\x00\x00"


ZIPS: dict[str, tuple[Change, str]] = {
    "a path upwards": (added("../../evil"), "is no name of a member"),
    "a path upwards in a ref": (added("../../v1/evil"), "is no name of a member"),
    "an absolute path": (added("/etc/cron.d/evil"), "is no name of a member"),
    "a backslash": (added("block-s\\encoder\\v1\\x"), "is no name of a member"),
    "a NUL in a name": (added(f"{ENCODER}/a\0b"), "is no name of a member|not in it|not belong"),
    "a hidden file": (added(f"{ENCODER}/.bashrc"), "does not belong in it"),
    "a folder": (added(f"{ENCODER}/"), "is no name of a member"),
    "a file too many": (added(f"{ENCODER}/evil.py"), "evil.py' does not belong in it"),
    "an artifact too many": (added("block-s/policy/v1/model"), "has no manifest in it"),
    "a symbolic link": (special(stat.S_IFLNK | 0o777), "is a link"),
    "a device": (special(stat.S_IFCHR | 0o666), "is a link, a folder or another special"),
    "a bomb": (compressed, "is compressed"),
    "a name twice": (twice, "is in it twice"),
    "an extra field": (extra, "not stored as elast stores it"),
    "no index": (dropped(INDEX), f"no {INDEX}"),
    "no manifest": (dropped("encoder/v1/manifest.yaml"), "has no manifest"),
    "no digest": (dropped("encoder/v1/manifest.yaml.sha256"), "has no manifest"),
    "no part": (dropped("encoder/v1/content.bin"), "content.bin is missing"),
    "no file of a part": (lambda found: found.__delitem__(slice(3, 6)), "but not in it"),
    "a changed file": (replaced("content.bin", lambda _: b"Content"), "its sha256 differs"),
    "a longer file": (replaced("content.bin", lambda x: x + b"!"), "has not the size 7"),
    "a changed manifest": (replaced("encoder/v1/manifest.yaml", lambda x: x + b" "), "was changed"),
    "too many members": (
        lambda found: found.extend(named(f"{ENCODER}/f{i}") for i in range(MAX_MEMBERS)),
        f"more than {MAX_MEMBERS} members",
    ),
    "a long index": (replaced(INDEX, lambda x: x + b"#" * (1 << 20)), "larger than"),
    "a newer elast": (indexed(schema_version=2), "pip install --upgrade elast"),
    "an unknown key": (indexed(run="touch owned"), "unknown key"),
    "a part of another task": (indexed(env="cable"), "is no encoder of cable"),
    "a part of another kind": (indexed(parts={"policy": f"{ENCODER}"}), "is no policy"),
    "a part with a path": (indexed(parts={"encoder": "../../v1"}), r"parts\.encoder"),
    "data as a part": (indexed(parts={"dataset": "block-s/dataset/v1"}), "is no dataset"),
}


@pytest.mark.parametrize("case", ZIPS)
def test_a_hostile_bundle_is_refused(path: Path, tmp_path: Path, case: str) -> None:
    change, message = ZIPS[case]
    rewrite(path, change)
    refused(path, tmp_path, message)


@pytest.mark.parametrize("case", YAML)
def test_hostile_yaml_as_an_index_is_refused(path: Path, tmp_path: Path, case: str) -> None:
    rewrite(path, replaced(INDEX, lambda _: YAML[case][0]))
    refused(path, tmp_path)


def test_a_bundle_cut_short_anywhere_is_refused(path: Path, tmp_path: Path) -> None:
    whole = path.read_bytes()
    for length in [0, 1, 21, 22, *range(100, len(whole), 251), len(whole) - 1]:
        path.write_bytes(whole[:length])
        refused(path, tmp_path)


def test_a_flipped_bit_anywhere_is_refused_or_changes_nothing(
    store: Store, path: Path, tmp_path: Path
) -> None:
    whole = path.read_bytes()
    sound = Store(tmp_path / "sound")
    unpack(path, sound)
    refusals = 0
    for place in range(0, len(whole), 97):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :])
        home = tmp_path / f"flip{place}"
        try:
            unpack(path, Store(home))
        except DataError:
            refusals += 1
            continue
        for file in (sound.home / "artifacts").glob("*/*/*/*"):
            assert (home / file.relative_to(sound.home)).read_bytes() == file.read_bytes()
    assert refusals > 0.8 * len(range(0, len(whole), 97))


def put(content: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    return lambda path: (path.write_bytes(content(path.read_bytes())), None)[1]


def end_record(data: bytes, at: int, form: str, value: int) -> bytes:
    """A zip with another number in the record at its end."""
    return data[: len(data) - 22 + at] + struct.pack(form, value) + data[len(data) - 22 + at :][4:]


FILES: dict[str, tuple[Callable[[Path], None], str]] = {
    "text": (put(lambda _: b"hello"), "no bundle"),
    "bytes before the zip": (put(lambda x: b"#!/bin/sh\n" + x), "not where elast writes it"),
    "bytes after the zip": (put(lambda x: x + b"more"), "no list of members"),
    "a comment": (put(lambda x: x[:-2] + b"\x04\x00more"), "no list of members"),
    "a long list": (put(lambda x: end_record(x, 12, "<L", 1 << 31)), "not where"),
    "a list elsewhere": (put(lambda x: end_record(x, 16, "<L", 7)), "not where"),
}


@pytest.mark.parametrize("case", FILES)
def test_a_file_that_is_no_bundle_is_refused(path: Path, tmp_path: Path, case: str) -> None:
    harm, message = FILES[case]
    harm(path)
    refused(path, tmp_path, message)


def test_pipes_and_folders_are_refused_and_nothing_is_missing_input(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    refused(tmp_path / "pipe", tmp_path, "not a regular file")
    (tmp_path / "folder").mkdir()
    refused(tmp_path / "folder", tmp_path)
    with pytest.raises(MissingInputError, match="no such file"):
        unpack(tmp_path / "none.zip", Store(tmp_path / "victim"))
