"""Reading bundles, which anyone may have made: checked as a whole before anything is written."""

from __future__ import annotations

import hashlib
import re
import struct
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO
from zipfile import ZIP_STORED, BadZipFile, ZipFile

from elast_cli.config import parse_yaml, validate
from elast_cli.errors import DataError, MissingInputError
from elast_cli.files import (
    make_folders,
    one_line,
    open_regular,
    refuse_links,
    remove_folder,
    storage_errors,
    sync_folder,
)
from elast_cli.store import origins
from elast_cli.store.bundle import INDEX, MODE, SCHEMA_VERSION, TEXTS, Contents
from elast_cli.store.locks import held
from elast_cli.store.manifest import (
    Manifest,
    Ref,
    measure,
    parse_manifest,
)
from elast_cli.store.run import next_version, record_version
from elast_cli.store.store import Store

MAX_MEMBERS = 512
MAX_TEXT = 1 << 20  # bytes of the index, of a manifest and of the list of members
_BLOCK = 1 << 20
_MEMBER = re.compile(r"([^/]+/[^/]+/[^/]+)/([^/]+)", re.ASCII)
_END = struct.Struct("<4s4H2LH")  # the record at the end of a zip
_ZIP64 = b"PK\x06\x07"  # begins 20 bytes before it in larger ones
_LOCAL, _CENTRAL = 30, 46  # bytes of a member's two headers, besides its name


@dataclass(frozen=True)
class Bundle:
    """A bundle that is sound as a whole; it is open.

    Attributes:
        contents: what its index says.
        manifests: of its parts and their ancestors, each with its digest.
        archive: the zip.
    """

    contents: Contents
    manifests: dict[Ref, tuple[Manifest, str]]
    archive: ZipFile

    def blocks(self, ref: Ref, name: str) -> Iterator[bytes]:
        """The content of a file."""
        with self.archive.open(f"{ref}/{name}") as file:
            while block := file.read(_BLOCK):
                yield block


def unpack(path: Path, store: Store) -> Contents:
    """What a bundle holds, once its parts are in a store under the refs that they had.

    Parts that are there already stay as they are. The manifests of other ancestors are kept as
    origins.

    Raises:
        MissingInputError: there is no such file.
        DataError: it is no bundle, or damaged, or unsafe, or the store has other artifacts under
            the same refs; then nothing is written.
        StorageError: the disk fails.
    """
    with opened(path) as bundle:
        parts = bundle.contents.refs.values()
        missing = [ref for ref in bundle.manifests if not _is_there(bundle, ref, store, path)]
        with storage_errors():
            for ref in missing:
                if ref in parts:
                    _place(bundle, ref, store)
                else:
                    texts = {name: b"".join(bundle.blocks(ref, name)) for name in TEXTS}
                    origins.keep(store, ref, bundle.manifests[ref][1], texts)
        return bundle.contents


@contextmanager
def opened(path: Path) -> Iterator[Bundle]:
    """A bundle, every byte of it checked.

    Raises:
        MissingInputError: there is no such file.
        DataError: it is no bundle, or damaged, or unsafe.
    """
    try:
        with open_regular(path) as file:
            _refuse_other_layout(file)
            with ZipFile(file) as archive:
                bundle = _checked(archive, file.seek(0, 2))
                yield bundle
    except FileNotFoundError:
        raise MissingInputError(f"{path}: no such file") from None
    except (BadZipFile, EOFError, NotImplementedError, RuntimeError, ValueError) as reason:
        raise DataError(f"{path}: not a sound bundle: {one_line(reason)}") from None
    except DataError as reason:
        at = "" if str(reason).startswith(str(path)) else f"{path}: "
        raise DataError(f"{at}{reason}") from None
    except OSError as reason:
        raise DataError(f"{path}: cannot be read: {one_line(reason)}") from None


def _refuse_other_layout(file: BinaryIO) -> None:
    """Raise ValueError unless a zip's list of members is short and ends the file."""
    size = file.seek(0, 2)
    file.seek(max(0, size - 20 - _END.size))
    tail = file.read()
    if len(tail) < _END.size or tail[-_END.size :][:4] != b"PK\x05\x06":
        raise ValueError("no list of members at its end; it is no bundle, or it was cut short")
    _, disk, first, here, count, length, at, comment = _END.unpack(tail[-_END.size :])
    whole = (disk, first, comment) == (0, 0, 0) and here == count
    if not whole or at + length + _END.size != size or tail.startswith(_ZIP64):
        raise ValueError("its list of members is not where elast writes it")
    if count > MAX_MEMBERS or length > MAX_TEXT:
        raise ValueError(f"more than {MAX_MEMBERS} members")


def _checked(archive: ZipFile, size: int) -> Bundle:
    """The bundle in a zip of some size. Raises DataError or ValueError naming what is wrong."""
    names = _members(archive, size)
    if INDEX not in names:
        raise ValueError(f"there is no {INDEX} in it")
    contents = _contents(_text(archive, INDEX))
    manifests = _manifests(archive, names, contents)
    bundle = Bundle(contents, manifests, archive)
    wanted = {INDEX}
    for ref, (manifest, _) in manifests.items():
        wanted |= {f"{ref}/{name}" for name in TEXTS}
        if ref in contents.refs.values():
            wanted |= {f"{ref}/{name}" for name in manifest.files}
            _check_files(bundle, ref, names)
    if odd := sorted(set(names) - wanted):
        raise ValueError(f"{odd[0]!r} does not belong in it")
    return bundle


def _members(archive: ZipFile, size: int) -> dict[str, int]:
    """Members and their sizes, if they fill the file one after another, plain and uncompressed."""
    found: dict[str, int] = {}
    place = listed = 0
    for member in archive.infolist():
        name = member.orig_filename
        if name in found:
            raise ValueError(f"{name!r} is in it twice")
        if name != INDEX and not _named(name):
            raise ValueError(f"{name!r} is no name of a member")
        if member.external_attr != MODE:
            raise ValueError(f"{name!r} is a link, a folder or another special file")
        if member.compress_type != ZIP_STORED or member.compress_size != member.file_size:
            raise ValueError(f"{name!r} is compressed, and bundles are not")
        if member.flag_bits or member.extra or member.comment or member.header_offset != place:
            raise ValueError(f"{name!r} is not stored as elast stores it")
        found[name] = member.file_size
        place += _LOCAL + len(name) + member.file_size
        listed += _CENTRAL + len(name)
    if place + listed + _END.size != size:
        raise ValueError("it holds more than its members")
    return found


def _named(name: str) -> bool:
    """Whether a name is that of a file of an artifact."""
    match = _MEMBER.fullmatch(name)
    return bool(match and Ref.maybe(match[1]))


def _text(archive: ZipFile, name: str) -> bytes:
    """The content of a small member."""
    if archive.getinfo(name).file_size > MAX_TEXT:
        raise ValueError(f"{name} is larger than {MAX_TEXT} bytes")
    return archive.read(name)


def _contents(content: bytes) -> Contents:
    """The index. Raises DataError if it is none, or says what cannot be."""
    data = parse_yaml(content, INDEX, error=DataError)
    schema = data.get("schema_version")
    if isinstance(schema, int) and schema > SCHEMA_VERSION:
        raise DataError(f"{INDEX}: of a newer elast; upgrade: pip install --upgrade elast")
    contents = validate(Contents, data, where=INDEX, error=DataError)
    for kind, ref in contents.refs.items():
        if (ref.env, ref.kind) != (contents.env, kind) or kind == "dataset":
            raise DataError(f"{INDEX}: {ref} is no {kind} of {contents.env}")
    return contents


def _manifests(
    archive: ZipFile, names: dict[str, int], contents: Contents
) -> dict[Ref, tuple[Manifest, str]]:
    """The manifests in a bundle, if they are of one lineage."""
    refs = {Ref.parse(name.rpartition("/")[0]) for name in names if name != INDEX}
    lost = sorted(set(contents.refs.values()) - refs)
    if lost:
        raise DataError(f"{lost[0]} is in its index, but not in it")
    found = {}
    for ref in sorted(refs):
        if {f"{ref}/{name}" for name in TEXTS} - set(names):
            raise DataError(f"{ref} has no manifest in it")
        content, recorded = (_text(archive, f"{ref}/{name}") for name in TEXTS)
        found[ref] = parse_manifest(content, recorded, ref)
    known = {x for manifest, digest in found.values() for x in (manifest.identity, digest)}
    for ref, (manifest, _) in found.items():
        for role, parent in manifest.parents.items():
            if Ref.parse(parent.ref) in found and parent.digest not in known:
                raise DataError(f"{ref}: its {role} is another {parent.ref} than the one in it")
    return found


def _check_files(bundle: Bundle, ref: Ref, names: dict[str, int]) -> None:
    """Raise DataError unless the files of a part are as its manifest says."""
    for name, entry in bundle.manifests[ref][0].files.items():
        if f"{ref}/{name}" not in names:
            raise DataError(f"{ref}: {name} is missing")
        if names[f"{ref}/{name}"] != entry.size:
            raise DataError(f"{ref}: {name} has not the size {entry.size}")
        digest = hashlib.sha256()
        for block in bundle.blocks(ref, name):
            digest.update(block)
        if digest.hexdigest() != entry.sha256:
            raise DataError(f"{ref}: {name} was changed: its sha256 differs")


def _is_there(bundle: Bundle, ref: Ref, store: Store, path: Path) -> bool:
    """Whether a store has an artifact of a bundle. Raises DataError if it has another one."""
    try:
        if bundle.manifests[ref][0].identity == store.digest(ref):
            return True
    except MissingInputError:
        return False
    raise DataError(
        f"{path}: {store.home} has another {ref}; unpack into a new folder: "
        f"ELAST_HOME=NEW elast unbundle {path}"
    )


def _place(bundle: Bundle, ref: Ref, store: Store) -> None:
    """Put a part into a store under its ref: whole, or not at all."""
    manifest, _ = bundle.manifests[ref]
    root = store.root(ref.kind)
    folder, recipe = root / ref.env / ref.kind, manifest.recipe_digest
    staging = root / ".staging" / f"{recipe}.{uuid.uuid4().hex}"
    refuse_links(staging.parent)
    with held(root, recipe, busy=f"another process is making {ref}"):
        make_folders(staging)
        try:
            for name in (*manifest.files, *TEXTS):
                with (staging / name).open("xb") as file:
                    file.writelines(bundle.blocks(ref, name))
                found = measure(staging / name, sync=True)
                if found != manifest.files.get(name, found):
                    raise DataError(f"{ref}: {name} changed while it was read")
            sync_folder(staging)
            make_folders(folder)
            with held(root, f"{ref.env}.{ref.kind}"):
                if next_version(folder) <= ref.version:
                    record_version(folder, ref.version)
                staging.rename(folder / f"v{ref.version}")
            sync_folder(folder)
        finally:
            if staging.exists():
                remove_folder(staging)
