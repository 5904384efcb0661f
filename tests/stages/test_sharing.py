"""Which parts and settings belong to an artifact."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from elast_cli.errors import DataError, UsageError
from elast_cli.stages import sharing
from elast_cli.stages.job import Job
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store
from tests.toys.artifacts import publish, recipe
from tests.toys.lineages import lineage

SETTINGS = {
    "method": "elast",
    "sections": {"planner": {"expansions": 7}, "control": {}},
    "env": {},
}


def test_a_part_comes_with_the_others_of_its_lineage(job: Job) -> None:
    first = lineage(job)
    lineage(job, mark=1)
    found = sharing.contents(job.store, first["policy"], overrides=["planner.expansions=9"])
    assert found.refs == {kind: ref for kind, ref in first.items() if kind != "dataset"}
    assert (found.preset, found.seed, found.method) == ("quick", 0, "elast")
    assert found.sections["planner"]["expansions"] == 9
    assert set(found.sections) == {"planner", "control", "env"}
    newest = sharing.contents(job.store, Ref("block-s", "policy", 2))
    assert newest.refs["encoder"] == Ref("block-s", "encoder", 2)


def test_a_dataset_is_no_part_of_a_method(job: Job) -> None:
    with pytest.raises(UsageError, match="uses no dataset; name a learned part"):
        sharing.contents(job.store, lineage(job)["dataset"])


def test_an_evaluation_has_its_own_method_parts_and_settings(job: Job) -> None:
    store, parts = job.store, lineage(job)
    del parts["dataset"]
    digests = {kind: store.digest(ref) for kind, ref in parts.items()}
    used = publish(store, recipe("eval", config=SETTINGS, parents=digests), parts)
    found = sharing.contents(store, used)
    assert found.refs == parts
    assert found.sections["planner"] == {"expansions": 7}
    with pytest.raises(UsageError, match="is of method elast, not cpc-cem"):
        sharing.contents(store, used, "cpc-cem")
    with pytest.raises(UsageError, match="has its own settings"):
        sharing.contents(store, used, overrides=["planner.expansions=9"])
    shutil.rmtree(store.path(parts["policy"]))
    with pytest.raises(DataError, match="its policy block-s/policy/v1 no longer exists"):
        sharing.contents(store, used)


@pytest.mark.parametrize(
    "config", [{}, {"method": 1, "sections": {}}, {"method": "elast"}, {**SETTINGS, "env": 3}]
)
def test_an_evaluation_without_settings_is_refused(job: Job, config: dict[str, object]) -> None:
    ref = publish(job.store, recipe("eval", config=config))
    with pytest.raises(DataError, match="block-s/eval/v1"):
        sharing.contents(job.store, ref)


def test_only_the_folder_of_an_artifact_names_one(job: Job, home: Path) -> None:
    ref = lineage(job)["encoder"]
    store, found = sharing.located(job.store.path(ref))
    assert (store.home, found) == (home, ref)
    for other in (home, home / "artifacts", Path("/"), home / "block-s/encoder/v1"):
        with pytest.raises(UsageError, match="not the folder of an artifact"):
            sharing.located(other)
    copied = Store(home / "other")
    shutil.copytree(home / "artifacts", copied.home / "artifacts")
    assert sharing.located(copied.path(ref))[0].home == copied.home


def test_contents_that_do_not_fit_their_method_are_refused(job: Job) -> None:
    found = sharing.contents(job.store, lineage(job)["policy"])
    changes: list[dict[str, object]] = [
        {"parts": {}},
        {"sections": {"env": {}}},
        {"method": "cpc-cem"},
        {"parts": {**found.parts, "graph": "block-s/graph/v1"}},
    ]
    for change in changes:
        with pytest.raises(DataError, match="do not fit"):
            sharing.ready(job.store, found.model_copy(update=change))
    with pytest.raises(UsageError, match="unknown method 'x'"):
        sharing.ready(job.store, found.model_copy(update={"method": "x"}))
