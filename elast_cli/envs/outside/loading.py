"""Outside code: found, imported, called and checked; its faults become one line each."""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import importlib.metadata
import inspect
import os
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np

from elast_cli.envs.outside.config import OutsideConfig
from elast_cli.errors import DataError, ElastError, UnavailableError, UsageError, suggestion
from elast_cli.files import one_line

Inner = gymnasium.Env[Any, Any]


@contextlib.contextmanager
def calling(env_id: str, what: str, error: type[ElastError] = DataError) -> Iterator[None]:
    """Run outside code: what it prints goes to stderr, what it raises is one line.

    Args:
        env_id: names the environment in errors.
        what: names the call in errors.
        error: class of the error that an exception becomes.
    """
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    except (ElastError, MemoryError):
        raise
    except gymnasium.error.DependencyNotInstalled as reason:
        raise UnavailableError(one_line(f"{env_id}: {what}: {reason}")) from reason
    except Exception as reason:
        place = traceback.extract_tb(reason.__traceback__)[-1]
        text = f"{type(reason).__name__}: {reason} ({place.filename}:{place.lineno})"
        raise error(one_line(f"{env_id}: {what} failed: {text}")) from reason


def make_inner(config: OutsideConfig) -> Inner:
    """The Gymnasium environment of a configuration, without a time limit.

    Raises:
        UsageError: it cannot be found, imported or made, or it lacks what elast needs.
        UnavailableError: it needs a package that is not installed.
    """
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # pygame draws without a display
    if not config.id:
        raise UsageError("an outside environment without an id; name it: --env ID")
    entry = _entry(config.id)
    with calling(config.id, "gymnasium.make", UsageError):
        env: Inner = gymnasium.make(
            entry,
            render_mode="rgb_array",
            max_episode_steps=-1,
            disable_env_checker=True,
            **config.kwargs,
        )
    _check_actions(config.id, env.action_space)
    modes = env.metadata.get("render_modes") or []
    if "rgb_array" not in modes or env.render_mode != "rgb_array":
        raise UsageError(
            f"{config.id}: it renders no images: its render modes are "
            f"{', '.join(map(str, modes)) or 'none'}, and elast needs rgb_array"
        )
    return env


def _entry(env_id: str) -> str | gymnasium.envs.registration.EnvSpec:
    """What `gymnasium.make` takes: a registered id, or a class of a module."""
    module_name, _, name = env_id.rpartition(":")
    module = load_module(module_name, f"--env {env_id}") if module_name else None
    if name in gymnasium.registry:
        return name
    found = getattr(module, name, None)
    if callable(found):
        return gymnasium.envs.registration.EnvSpec(id=name, entry_point=found)
    classes = [
        key
        for key, value in vars(module).items()
        if isinstance(value, type) and issubclass(value, gymnasium.Env)
    ]
    hint = suggestion(name, [*classes, *gymnasium.registry])
    raise UsageError(
        f"--env {env_id}: Gymnasium knows no {name!r}{hint}, and {module_name or 'no module'} "
        "has no such class; register it when the module is imported"
    )


def load_module(name: str, where: str) -> ModuleType:
    """A module of outside code, from the working directory if it is nowhere else.

    Raises:
        UsageError: there is none, or importing it fails; `where` names who asked for it.
    """
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    try:
        with calling(where, f"importing {name}", UsageError):
            return importlib.import_module(name)
    except UsageError as error:
        missing = error.__cause__
        if isinstance(missing, ModuleNotFoundError) and f"{name}.".startswith(f"{missing.name}."):
            raise UsageError(
                f"{where}: there is no module {missing.name!r}; install its package, or run elast "
                "in the folder that has it"
            ) from None
        raise


def load_hook(name: str) -> Callable[..., Any]:
    """The function that `module:function` names.

    Raises:
        UsageError: there is no such function, or importing its module fails.
    """
    module_name, _, path = name.partition(":")
    found: Any = load_module(module_name, f"env.goal={name}")
    for word in path.split("."):
        found = getattr(found, word, None)
    if not callable(found):
        raise UsageError(f"env.goal={name}: {module_name} has no function {path!r}")
    return found  # type: ignore[no-any-return]  # it can be called


def version_of(*sources: object) -> str:
    """Packages and versions that classes and functions come from, each once.

    What belongs to no package is named by its module and a digest of its source file.
    """
    return ", ".join(dict.fromkeys(map(_version, sources)))


def _version(source: object) -> str:
    module = getattr(source, "__module__", None) or type(source).__module__
    packages = importlib.metadata.packages_distributions().get(module.partition(".")[0])
    if packages:
        name = min(packages)
        return f"{name} {importlib.metadata.version(name)}"
    file = inspect.getsourcefile(sys.modules[module])
    if file is None:
        return module
    return f"{module} {hashlib.sha256(Path(file).read_bytes()).hexdigest()[:16]}"


def _check_actions(env_id: str, space: gymnasium.Space[Any]) -> None:
    """Raise UsageError unless actions are real numbers in a bounded box."""
    if not isinstance(space, gymnasium.spaces.Box) or not np.issubdtype(space.dtype, np.floating):
        kind = type(space).__name__
        raise UsageError(
            f"{env_id}: its actions are {kind}({space.dtype}); elast needs a Box of real numbers"
        )
    wide = np.asarray(space.high, np.float64) - np.asarray(space.low, np.float64)
    if not space.shape or not wide.size or not np.isfinite(wide).all() or not (wide > 0).all():
        raise UsageError(
            f"{env_id}: its action box {space} has no finite bounds that differ; wrap it in "
            "gymnasium.wrappers.RescaleAction or give it bounds"
        )
