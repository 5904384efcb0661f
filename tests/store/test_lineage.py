"""Parents of artifacts, down to the data."""

from __future__ import annotations

import shutil
from typing import Any

import pytest

from elast_cli.errors import DataError
from elast_cli.stages.inspect import description
from elast_cli.store.manifest import Recipe, read_manifest
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
    forge(store, data, lambda found: found["files"]["content.bin"].update(sha256="0" * 64))
    with pytest.raises(DataError, match="not the one that it was made from"):
        store.lineage(encoder)
    shutil.rmtree(store.path(data))
    with pytest.raises(DataError, match="no longer exists"):
        store.verify(encoder)
    (parent,) = store.lineage(encoder, allow_lost=True).parents
    assert (parent.ref, parent.lost) == (data, True)
    assert description(store, str(encoder))["digest"] == store.digest(encoder)


def test_when_and_where_an_artifact_was_made_is_not_what_it_is(store: Store) -> None:
    data = publish(store, recipe())
    before = store.digest(data)
    forge(store, data, lambda found: found["provenance"].update(created="yesterday"))
    forge(store, data, lambda found: found["metrics"].update(wall_s=1.0))
    assert store.digest(data) == before


def test_what_was_lost_and_made_again_is_the_same_parent(store: Store) -> None:
    data = publish(store, recipe())
    encoder = child_of(store, data)
    shutil.rmtree(store.path(data))
    again = publish(store, recipe())
    assert again != data  # a version number is never given twice
    assert [node.ref for node in store.lineage(encoder).parents] == [again]
    assert store.verify(encoder).ref == encoder
    assert child_of(store, again) == encoder  # nothing is made anew


def test_parents_that_an_older_version_recorded_are_known(store: Store) -> None:
    """It took the digest of the parent's manifest, which names when that was made."""
    data = publish(store, recipe())
    manifest_digest = read_manifest(store.path(data), data)[1]
    encoder = child_of(store, data)

    def older(found: dict[str, Any]) -> None:
        found["parents"]["dataset"]["digest"] = manifest_digest
        found["recipe"]["parents"]["dataset"] = manifest_digest
        found["recipe_digest"] = Recipe.model_validate(found["recipe"]).digest

    forge(store, encoder, older)
    assert store.parents(encoder) == {"dataset": store.digest(data)}
    assert store.verify(encoder).ref == encoder
