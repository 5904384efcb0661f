"""Refs, recipes and their digests, as they are written and read."""

from __future__ import annotations

import subprocess
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elast_cli.config import dump_yaml, parse_yaml
from elast_cli.errors import UsageError
from elast_cli.store.manifest import MANIFEST_DIGEST, Recipe, Ref
from elast_cli.store.store import Store
from tests.toys.artifacts import publish, recipe


def test_a_ref_reads_as_it_is_written() -> None:
    assert Ref.parse("block-s/encoder/v12") == Ref("block-s", "encoder", 12)
    assert str(Ref("block-s", "encoder", 12)) == "block-s/encoder/v12"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "block-s",
        "block-s/encoder/2",
        "block-s/encoder/v0",
        "../encoder/v1",
        "a/b/v1/",
        "a/b/v\uff11",
        "a/b/v1\n",
    ],
)
def test_a_wrong_ref_is_refused_with_its_form(text: str) -> None:
    with pytest.raises(UsageError, match="block-s/encoder/v2"):
        Ref.parse(text)


def test_sha256sum_accepts_the_digest_file(store: Store) -> None:
    folder = store.path(publish(store, recipe()))
    subprocess.run(["sha256sum", "--check", "--strict", MANIFEST_DIGEST], cwd=folder, check=True)


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 1},
        {"config": {"n": 2}},
        {"preset": "paper"},
        {"device": "cuda"},
        {"threads": 2},
        {"algorithm_version": 2},
        {"render_backend": "egl"},
        {"parents": {"dataset": "0" * 64}},
    ],
)
def test_whatever_determines_the_content_changes_the_recipe_digest(change: dict[str, Any]) -> None:
    assert recipe(**change).digest != recipe().digest


json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**63)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(codec="utf-8"), max_size=20),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=10,
)


@settings(max_examples=60, deadline=None)
@given(st.dictionaries(st.text(st.characters(codec="utf-8"), max_size=8), json_values, max_size=4))
def test_yaml_gives_every_recipe_back_with_its_digest(config: dict[str, Any]) -> None:
    made = recipe(config=config)
    read = parse_yaml(dump_yaml(made.model_dump()).encode(), "recipe")
    assert Recipe.model_validate(read).digest == made.digest
