"""Names of outside environments in refs."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from elast_cli.envs.outside.names import is_id, is_outside, name_of
from elast_cli.envs.registry import EnvSpec, named, register
from elast_cli.errors import UsageError
from elast_cli.store.manifest import Ref


@pytest.mark.parametrize(
    ("env_id", "name"),
    [
        ("Pendulum-v1", "gym-pendulum-v1"),
        ("ALE/Pong-v5", "gym-ale-pong-v5"),
        ("my_envs.room:Room", "gym-my_envs-room-room"),
    ],
)
def test_an_id_has_a_name_that_refs_can_hold(env_id: str, name: str) -> None:
    assert name_of(env_id) == name


@given(st.from_regex(r"[A-Za-z_][\w.]{0,90}:[\w./-]{1,90}", fullmatch=True))
def test_every_name_is_one_of_a_ref(env_id: str) -> None:
    name = name_of(env_id)
    assert is_outside(name)
    assert Ref.maybe(f"{name}/dataset/v1") is not None


def test_long_ids_that_begin_alike_have_different_names() -> None:
    ids = [f"package.{'deep.' * 20}module:Room{i}" for i in range(2)]
    assert name_of(ids[0]) != name_of(ids[1])


def test_an_id_is_registered_or_has_a_module() -> None:
    assert is_id("Pendulum-v1")
    assert is_id("no_such.module:Id-v0")
    assert not is_id("Pendulm-v1")
    assert not is_id("block-s")


def test_a_text_names_a_task_of_ours_by_both_of_its_names() -> None:
    assert named("cable") == named("elast/Cable-v0") == ("cable", None)
    assert named("Pendulum-v1") == ("gym-pendulum-v1", "Pendulum-v1")
    assert named("gym-pendulum-v1") == ("gym-pendulum-v1", None)
    with pytest.raises(UsageError, match=r"'Pendulm-v1' \(did you mean 'Pendulum-v1'\?\)"):
        named("Pendulm-v1")


def test_a_plug_in_cannot_take_the_name_of_an_outside_environment() -> None:
    with pytest.raises(UsageError, match="names that begin with gym- are taken"):
        register(EnvSpec(name="gym-room", entry_point="room:Room", about="a room"))
