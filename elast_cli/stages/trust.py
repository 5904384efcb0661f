"""Consent to outside code: the command line gives it, a file does not.

Reading an artifact or a preset that names an outside environment imports nothing. Running it does.
"""

from __future__ import annotations

from collections.abc import Collection

from elast_cli.config import JsonDict
from elast_cli.envs.outside.config import CODE_KEYS, INFO, RANDOM
from elast_cli.envs.outside.names import is_outside, may_be_id
from elast_cli.envs.registry import named
from elast_cli.errors import DataError, MissingInputError, UntrustedError
from elast_cli.preset import ENV
from elast_cli.store.manifest import Ref
from elast_cli.store.store import Store

FLAG = "--trust-code"


def identified(store: Store, text: str, *, trusted: bool) -> tuple[str, str | None]:
    """An environment's name, and its id if it is an outside one; see `registry.named`.

    For a name out of a ref, such as `gym-pendulum-v1`, the id stands in the artifacts.

    Raises:
        UntrustedError: it does, and nothing but the artifacts names it.
        MissingInputError: there is no artifact of that name.
    """
    name, env_id = named(text)
    if env_id is not None or not is_outside(name):
        return name, env_id
    ref, recorded = _recorded(store, name)
    if not trusted:
        raise UntrustedError(
            f"{ref} names {recorded!r}, which is code of another package, and only the command "
            f"line may ask for that: add --env {recorded}, or {FLAG}"
        )
    return name, recorded


def refuse_untrusted(env: JsonDict, commanded: Collection[str], *, trusted: bool) -> None:
    """Raise UntrustedError if a preset's file names code.

    Args:
        env: the complete section `env`.
        commanded: texts section.key=value of the command line.
        trusted: whether `--trust-code` was given.
    """
    agreed = {text.partition("=")[0].strip() for text in commanded}
    for key in CODE_KEYS:
        value = env.get(key)
        if value in (None, "", INFO, RANDOM) or f"{ENV}.{key}" in agreed or trusted:
            continue
        raise UntrustedError(
            f"{ENV}.{key} of the preset names code, {value!r}, and only the command line may ask "
            f"for that: add --set {ENV}.{key}={value}, or {FLAG}"
        )


def _recorded(store: Store, name: str) -> tuple[Ref, str]:
    """The newest artifact of an outside environment that holds its id, and that id."""
    for ref in reversed(store.refs(name)):
        try:
            section = store.manifest(ref).recipe.config.get(ENV)
        except DataError:
            continue
        found = section.get("id") if isinstance(section, dict) else None
        if isinstance(found, str) and may_be_id(found):
            return ref, found
    raise MissingInputError(
        f"there is no artifact of {name}; name the environment by its Gymnasium id, as in "
        "--env Pendulum-v1"
    )
