"""The manifest of a published artifact: its ref, its recipe, its parents and its files.

`manifest.yaml` is canonical YAML. `manifest.yaml.sha256` beside it holds its digest in the format
of `sha256sum -c`; that digest names the exact artifact, and its children record it.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import json
import os
import platform
import re
import subprocess
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

from pydantic import Field, StringConstraints

import elast_cli
from elast_cli.config import JsonDict, StrictModel, dump_yaml, parse_yaml, validate
from elast_cli.errors import DataError, MissingInputError, UsageError
from elast_cli.files import open_regular, read_regular

SCHEMA_VERSION = 1
MANIFEST = "manifest.yaml"
MANIFEST_DIGEST = "manifest.yaml.sha256"
REF_FORM = "<env>/<kind>/v<N>, as in block-s/encoder/v2"

_NAME = r"[a-z0-9][a-z0-9_-]{0,63}"
_REF = re.compile(rf"({_NAME})/({_NAME})/v([1-9][0-9]{{0,8}})", re.ASCII)
Name = Annotated[str, StringConstraints(pattern=rf"^{_NAME}$")]
FileName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,127}$")]
RefText = Annotated[str, StringConstraints(pattern=rf"^{_REF.pattern}$")]
Digest = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]

_LIBRARIES = (
    "torch",
    "numpy",
    "scipy",
    "h5py",
    "zlib-ng",
    "gymnasium",
    "pymunk",
    "safetensors",
    "pydantic",
)


@dataclass(frozen=True, order=True)
class Ref:
    """The name of one published version, written `<env>/<kind>/v<N>`."""

    env: str
    kind: str
    version: int

    @classmethod
    def parse(cls, text: str) -> Ref:
        """The ref that `text` names. Raises UsageError if it has another form."""
        if ref := cls.maybe(text):
            return ref
        raise UsageError(f"{text!r} is not a ref; a ref reads {REF_FORM} (list them: elast ls)")

    @classmethod
    def maybe(cls, text: str) -> Ref | None:
        """The ref that `text` names, or None if it has another form."""
        match = _REF.fullmatch(text)
        return cls(match[1], match[2], int(match[3])) if match else None

    def __str__(self) -> str:
        """The ref as people type it."""
        return f"{self.env}/{self.kind}/v{self.version}"


class Recipe(StrictModel):
    """Everything that determines an artifact's content; equal digests mean equal content."""

    kind: Name
    env: Name
    seed: Annotated[int, Field(ge=0)]
    preset: str
    config: JsonDict
    parents: dict[Name, Digest] = Field(default_factory=dict)  # role -> the parent's identity
    render_backend: str | None = None
    device: str = "cpu"
    threads: Annotated[int, Field(ge=1)] = 1
    algorithm_version: Annotated[int, Field(ge=1)] = 1
    variant: JsonDict = Field(default_factory=dict)  # a method's changes to parts, by kind

    @property
    def digest(self) -> str:
        """SHA-256 of the recipe's canonical JSON; an empty variant leaves no trace in it."""
        data = self.model_dump(exclude=None if self.variant else {"variant"})
        text = json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()


class Parent(StrictModel):
    """An artifact this one was made from: its ref, and its identity."""

    ref: RefText
    digest: Digest


class FileEntry(StrictModel):
    """Size in bytes and SHA-256 of one file of an artifact."""

    size: Annotated[int, Field(ge=0)]
    sha256: Digest


class Manifest(StrictModel):
    """The content of `manifest.yaml`."""

    schema_version: int = SCHEMA_VERSION
    version: Annotated[int, Field(ge=1)]
    recipe: Recipe
    recipe_digest: Digest
    parents: dict[Name, Parent]  # the roles of recipe.parents, each with its ref
    files: dict[FileName, FileEntry]
    metrics: JsonDict
    provenance: JsonDict

    @property
    def identity(self) -> str:
        """SHA-256 of recipe and files: what the artifact is, not when and where it was made.

        Data and models that are made again have the same. Plans and evaluations hold seconds.
        """
        files = {name: entry.sha256 for name, entry in self.files.items()}
        text = json.dumps([self.recipe_digest, files], sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def ref(self) -> Ref:
        """The name under which the artifact was published."""
        return Ref(self.recipe.env, self.recipe.kind, self.version)


def write_manifest(folder: Path, manifest: Manifest) -> str:
    """Digest of the manifest, once it and its digest file are on disk in `folder`."""
    content = dump_yaml(manifest.model_dump()).encode()
    digest = hashlib.sha256(content).hexdigest()
    for name, data in ((MANIFEST, content), (MANIFEST_DIGEST, f"{digest}  {MANIFEST}\n".encode())):
        (folder / name).unlink(missing_ok=True)  # left by a lost race for the version number
        with open(folder / name, "xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    return digest


def read_manifest(folder: Path, ref: Ref) -> tuple[Manifest, str]:
    """The verified manifest of the artifact in `folder`, and the manifest's digest.

    Raises:
        DataError: damaged, unsafe, written by a newer elast, or not of `ref`.
    """
    content, digest = _intact(folder, ref)
    return _checked(content, ref), digest


def holds(folder: Path, ref: Ref, text: str) -> bool:
    """Whether a manifest holds some text: quick to tell, since nothing is parsed.

    Args:
        folder: of the artifact.
        ref: its name, for errors.
        text: what to look for in the bytes of the manifest.

    Raises:
        DataError: damaged, or not of a published artifact.
    """
    return text.encode() in _intact(folder, ref)[0]


def _intact(folder: Path, ref: Ref) -> tuple[bytes, str]:
    """A manifest's bytes and their digest, which is the recorded one."""
    try:
        if folder.is_symlink():
            raise DataError(f"{ref}: its folder is a symbolic link; copy the artifact instead")
        refuse_link(folder / MANIFEST, ref)
        refuse_link(folder / MANIFEST_DIGEST, ref)
        content = read_regular(folder / MANIFEST, error=DataError, max_bytes=1 << 20)
        recorded = read_regular(folder / MANIFEST_DIGEST, error=DataError, max_bytes=1 << 10)
    except MissingInputError as reason:
        raise DataError(f"{ref}: incomplete: {reason}") from None
    return content, _agreed(content, recorded, ref)


def parse_manifest(content: bytes, recorded: bytes, ref: Ref) -> tuple[Manifest, str]:
    """`read_manifest` of the bytes of both files.

    Args:
        content: of `manifest.yaml`.
        recorded: of `manifest.yaml.sha256`.
        ref: what it should be the manifest of.

    Raises:
        DataError: as there.
    """
    return _checked(content, ref), _agreed(content, recorded, ref)


def _agreed(content: bytes, recorded: bytes, ref: Ref) -> str:
    """The digest of a manifest. Raises DataError if another one was recorded."""
    digest = hashlib.sha256(content).hexdigest()
    if recorded != f"{digest}  {MANIFEST}\n".encode():
        raise DataError(f"{ref}: {MANIFEST} does not match {MANIFEST_DIGEST}; it was changed")
    return digest


@functools.lru_cache(maxsize=256)
def _checked(content: bytes, ref: Ref) -> Manifest:
    where = f"{ref}: {MANIFEST}"
    data = parse_yaml(content, where, error=DataError)
    schema = data.get("schema_version")
    if isinstance(schema, int) and schema > SCHEMA_VERSION:
        raise DataError(
            f"{where}: schema {schema} is newer than {SCHEMA_VERSION}, the newest this elast "
            f"{elast_cli.__version__} reads; upgrade it: pip install --upgrade elast"
        )
    manifest = validate(Manifest, data, where=where, error=DataError)
    if schema != SCHEMA_VERSION:
        raise DataError(f"{where}: schema_version: expected {SCHEMA_VERSION}, got {schema}")
    if manifest.ref != ref:
        raise DataError(f"{where}: it is the manifest of {manifest.ref}")
    if manifest.recipe_digest != manifest.recipe.digest:
        raise DataError(f"{where}: recipe_digest is not the digest of its recipe")
    recorded = {role: parent.digest for role, parent in manifest.parents.items()}
    if recorded != manifest.recipe.parents:
        raise DataError(f"{where}: parents differ from the parents in its recipe")
    return manifest


def refuse_link(path: Path, ref: Ref) -> None:
    """Raise DataError if an artifact's member would lead to another path."""
    if path.is_symlink():
        raise DataError(f"{ref}: {path.name} is a symbolic link")


def measure(path: Path, *, sync: bool = False) -> FileEntry:
    """Size and SHA-256 of a file; with `sync`, after it is on disk.

    Raises:
        ValueError: a symbolic link, a folder or a device.
    """
    if path.is_symlink():
        raise ValueError(f"{path.name} is a symbolic link")
    with open_regular(path) as file:
        if sync:
            os.fsync(file.fileno())
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        return FileEntry(size=file.tell(), sha256=digest)


def provenance() -> JsonDict:
    """Software, machine and time of an artifact; for information only."""
    found: JsonDict = {}
    for name in _LIBRARIES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "elast": elast_cli.__version__,
        "libraries": found,
        "platform": platform.platform(),
        "python": platform.python_version(),
        **_git_state(Path(elast_cli.__file__).resolve().parent.parent),
    }


def _git_state(root: Path) -> JsonDict:
    """Commit and dirty flag if `root` is the top of a git checkout, else nothing."""
    if not (root / ".git").exists():
        return {}

    def git(*words: str) -> str:
        command = ["git", "-C", str(root), *words]
        # a git hook sets GIT_DIR and others, which name another repository
        ours = {k: v for k, v in os.environ.items() if not k.startswith("GIT_")}
        return subprocess.run(
            command, capture_output=True, text=True, check=True, timeout=10, env=ours
        ).stdout.strip()

    try:
        return {
            "git_commit": git("rev-parse", "HEAD"),
            "git_dirty": bool(git("status", "--porcelain", "--untracked-files=no")),
        }
    except (OSError, subprocess.SubprocessError):
        return {}
