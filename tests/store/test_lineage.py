"""Parents of artifacts, down to the data."""

from __future__ import annotations

import shutil

import pytest

from elast_cli.errors import DataError
from elast_cli.stages.inspect import description
from elast_cli.store.store import Store
from tests.toys.artifacts import child_of, forge, publish, recipe


def test_lineage_leads_back_to_the_dataset_and_verifies(store: Store) -> None:
    data = publish(store, recipe())
    encoder = child_of(store, data)
    policy = publish(
        store,
        recipe("policy", parents={"dataset": store.digest(data), "encoder": store.digest(encoder)}),
        {"dataset": data, "encoder": encoder},
    )
    root = store.lineage(policy)
    assert (root.ref, root.role) == (policy, "")
    assert {node.role: node.ref for node in root.parents} == {"dataset": data, "encoder": encoder}
    assert store.verify(policy).ref == policy
    with open(store.path(data) / "content.bin", "r+b") as file:
        file.write(b"C")
    with pytest.raises(DataError, match=r"block-s/dataset/v1: content\.bin was changed"):
        store.verify(policy)


def test_a_parent_that_changed_since_the_recipe_was_written_is_refused(store: Store) -> None:
    data = publish(store, recipe())
    stale = recipe("encoder", parents={"dataset": "0" * 64})
    with pytest.raises(DataError, match="parents"):
        publish(store, stale, {"dataset": data})


def test_a_replaced_or_removed_parent_breaks_the_lineage(store: Store) -> None:
    data = publish(store, recipe())
    encoder = child_of(store, data)
    forge(store, data, lambda found: found["metrics"].update(loss=0.0))
    with pytest.raises(DataError, match="another one than it was made from"):
        store.lineage(encoder)
    shutil.rmtree(store.path(data))
    with pytest.raises(DataError, match="no longer exists"):
        store.verify(encoder)
    (parent,) = store.lineage(encoder, allow_lost=True).parents
    assert (parent.ref, parent.lost) == (data, True)
    assert description(store, str(encoder))["digest"] == store.digest(encoder)
