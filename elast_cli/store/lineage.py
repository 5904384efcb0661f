"""The lineage of an artifact: its parents, their parents, and so on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from elast_cli.errors import DataError, MissingInputError
from elast_cli.store import origins
from elast_cli.store.manifest import Parent, Ref

if TYPE_CHECKING:
    from elast_cli.store.store import Store

MAX_GENERATIONS = 32


@dataclass(frozen=True)
class LineageNode:
    """An artifact, the role it plays for its child ("" at the root), and its own parents.

    `lost`: it does not exist; then its parents are not shown.
    """

    ref: Ref
    role: str
    parents: tuple[LineageNode, ...]
    lost: bool = False


def lineage(store: Store, ref: Ref, *, allow_lost: bool = False) -> LineageNode:
    """The artifact and its ancestors; see `Store.lineage`.

    Args:
        store: has all of them.
        ref: the artifact.
        allow_lost: whether a missing parent is listed as lost and raises no error.
    """
    parents: dict[Ref, tuple[LineageNode, ...]] = {}

    def visit(child: Ref, path: tuple[Ref, ...]) -> tuple[LineageNode, ...]:
        if child not in parents:
            found = []
            for role, recorded in store.manifest(child).parents.items():
                named = Ref.parse(recorded.ref)
                if named in path or len(path) > MAX_GENERATIONS:
                    raise DataError(f"{child}: its {role} {named} closes a cycle")
                parent = present(store, child, role, recorded)
                if parent is None or parent in path:  # it cannot be its own ancestor
                    if not allow_lost and not (parent is None and origins.find(store, recorded)):
                        raise DataError(f"{child}: its {role} {named} no longer exists")
                    found.append(LineageNode(named, role, (), lost=True))
                    continue
                found.append(LineageNode(parent, role, visit(parent, (*path, parent))))
            parents[child] = tuple(found)
        return parents[child]

    return LineageNode(ref, "", visit(ref, (ref,)))


def present(store: Store, child: Ref, role: str, recorded: Parent) -> Ref | None:
    """The parent that was recorded, or another version that is the same; None if it is lost.

    Args:
        store: where to look.
        child: the artifact whose parent is sought, for errors.
        role: of the parent, for errors.
        recorded: ref and digest that the child's manifest has.

    Raises:
        DataError: there is another one in its place.
    """
    ref = Ref.parse(recorded.ref)
    taken = store.path(ref).exists()
    if taken and recorded.digest in store.digests(ref):
        return ref
    for other in reversed(store.refs(ref.env, ref.kind)):
        try:
            if other != ref and recorded.digest in store.digests(other):
                return other
        except (DataError, MissingInputError):
            continue  # damaged, or removed just now
    if taken:
        raise DataError(
            f"{child}: its {role} {ref} is not the one that it was made from "
            f"(digest {store.digest(ref)[:12]}, recorded {recorded.digest[:12]})"
        )
    return None


def postorder(node: LineageNode) -> list[LineageNode]:
    """Every artifact of a lineage once, parents before children."""
    ordered: dict[Ref, LineageNode] = {}

    def visit(node: LineageNode) -> None:
        if node.ref not in ordered:
            for parent in node.parents:
                visit(parent)
            ordered[node.ref] = node

    visit(node)
    return list(ordered.values())
