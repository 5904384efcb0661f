"""Refs, recipes and their digests, as they are written and read."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elast_cli.config import dump_yaml, parse_yaml, read_yaml
from elast_cli.errors import UsageError
from elast_cli.store import manifest
from elast_cli.store.manifest import MANIFEST, MANIFEST_DIGEST, Recipe, Ref, provenance
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
        {"variant": {"ensemble": {"net": {"members": 1}}}},
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


GOLDEN = "c3b5f3ea938eef2c2553ef013a78717e"  # as elast 0.1 made it, before there were variants


def test_a_recipe_without_a_variant_has_the_digest_that_it_always_had() -> None:
    made = recipe(config={"n": 3, "keep": 0.5}, parents={"encoder": "ab" * 32}, seed=2)
    assert made.digest.startswith(GOLDEN)
    assert recipe(variant={}).digest == recipe().digest


COMMITTED = Path(__file__).parents[2] / "docs" / "results" / "models"


@pytest.mark.parametrize("path", sorted(COMMITTED.glob("artifacts/*/*/v*")), ids=str)
def test_recipes_of_committed_models_still_have_their_digests(path: Path) -> None:
    ref = Ref.parse("/".join(path.parts[-3:]))
    manifest = Store(COMMITTED).manifest(ref)
    assert manifest.recipe.digest == manifest.recipe_digest
    assert manifest.recipe.variant == {}
    if ref.env not in ("button", "drawer", "reach"):  # the others are older than variants
        assert "variant" not in read_yaml(path / MANIFEST)["recipe"]  # type: ignore[operator]


def test_a_git_hook_of_another_repository_does_not_name_the_commit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone = provenance().get("git_commit", "none")
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
    words = [
        "-c",
        "user.name=a",
        "-c",
        "user.email=a@b",
        "commit",
        "-q",
        "--allow-empty",
        "-m",
        "x",
    ]
    subprocess.run(["git", "-C", str(tmp_path), *words], check=True)
    monkeypatch.setenv("GIT_DIR", str(tmp_path / ".git"))
    monkeypatch.setenv("GIT_WORK_TREE", str(tmp_path))
    assert provenance().get("git_commit", "none") == alone
    assert manifest._git_state(tmp_path)["git_commit"] != alone  # that repository has one
