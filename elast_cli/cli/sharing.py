"""`elast bundle` and `elast unbundle`: a method with its parts in one file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from elast_cli.cli import completion
from elast_cli.cli.options import Json, Quiet
from elast_cli.cli.output import print_json, print_text

if TYPE_CHECKING:
    from elast_cli.store.bundle import Contents


def bundle(
    ref: Annotated[str, typer.Argument(metavar="REF")],
    output: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The file; default: ENV-METHOD.zip."),
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(
            help="Method; default: that of an evaluation or a plan, else elast.",
            autocompletion=completion.methods,
        ),
    ] = None,
    set: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="SECTION.KEY=VALUE", help="Override one setting."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the file if it exists.")] = False,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Write all parts of a method into one file that can be shared.

    REF is one of its learned parts, or an evaluation or a plan that was made with it.
    """
    from elast_cli.cli.console import reporter
    from elast_cli.stages import sharing
    from elast_cli.store.manifest import Ref
    from elast_cli.store.store import Store

    store = Store.default()
    found = sharing.contents(
        store, Ref.parse(ref), method, overrides=set or [], progress=reporter(quiet=quiet)
    )
    path = output or Path(f"{found.env}-{found.method}.zip")
    sharing.bundle(store, found, path, force=force)
    if json:
        print_json({"file": str(path), "bytes": path.stat().st_size, **found.model_dump()})
    else:
        print_text(str(path))


def unbundle(
    file: Annotated[Path, typer.Argument(metavar="FILE")],
    json: Json = False,
) -> None:
    """Put the parts of a bundle into the store under their refs, checked."""
    found = unpacked(file)
    refs = list(found.parts.values())
    print_json(found.model_dump()) if json else print_text("\n".join(refs))


def unpacked(path: Path) -> Contents:
    """What a bundle holds, once it is in the store."""
    from elast_cli.store.store import Store
    from elast_cli.store.unbundle import unpack

    return unpack(path, Store.default())
