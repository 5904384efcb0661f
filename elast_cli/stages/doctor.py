"""`elast doctor`: what this machine has, what is missing, and how to fix it."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from elast_cli.compiled import MADE, PLACE, VARIABLE
from elast_cli.engine.local import usable_cores
from elast_cli.errors import UnavailableError
from elast_cli.files import expanded
from elast_cli.store.locks import supported

if TYPE_CHECKING:
    from rich.table import Table

_SOURCES = Path(__file__).parents[2]
LEAST_FREE = 2 << 30  # bytes; a standard run takes a tenth of it
_RENDER = """
import mujoco
model = mujoco.MjModel.from_xml_string('<mujoco><worldbody><geom size="1"/></worldbody></mujoco>')
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
renderer = mujoco.Renderer(model, 64, 64)
renderer.update_scene(data)
renderer.render()
renderer.close()
"""
_ROBOT = """
from elast_cli.envs.registry import make
env = make("reach")
env.reset(seed=0)
env.step(env.action_space.sample())
"""
_NO_GPU = "none; everything runs on the CPU (preset paper needs one)"
_GL_PACKAGES = {"egl": "libegl1 libgl1", "osmesa": "libosmesa6"}


class Check(NamedTuple):
    """One finding: `fail` stops elast, `warn` only limits it; `remedy` is the command to run."""

    name: str
    status: Literal["ok", "warn", "fail"]
    value: str
    remedy: str = ""


def checks() -> list[Check]:
    """All findings, the most important first."""
    return [
        _python(),
        *_packages(),
        *_processor(),
        _compiled(),
        *_torch(),
        _robot_tasks(),
        *_renderers(),
        _store(),
        _locks(),
        _disk(),
    ]


def table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """The findings for people."""
    from rich import box
    from rich.table import Table

    shown = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for name in ("check", "", "found", "fix"):
        shown.add_column(name, overflow="fold")
    for row in rows:
        shown.add_row(row["name"], row["status"], row["value"], row["remedy"])
    return shown


def refuse_failed(found: Sequence[Check]) -> None:
    """Raise UnavailableError if something keeps elast from working."""
    failed = [check for check in found if check.status == "fail"]
    if failed:
        first = failed[0]
        raise UnavailableError(f"{first.name}: {first.value}; run: {first.remedy}")


def _python() -> Check:
    fits = (3, 11) <= sys.version_info < (3, 14)
    return Check(
        "python",
        "ok" if fits else "fail",
        f"{platform.python_version()} on {platform.platform()}",
        "" if fits else "install Python 3.11, 3.12 or 3.13",
    )


def _packages() -> list[Check]:
    """elast and everything it depends on."""
    try:
        wanted = importlib.metadata.requires("elast") or []
    except importlib.metadata.PackageNotFoundError:
        return [Check("elast", "warn", "not installed, run from its folder", "pip install -e .")]
    found = [Check("elast", "ok", importlib.metadata.version("elast"))]
    for requirement in sorted(wanted):
        if "extra ==" in requirement:
            continue
        name = re.split(r"[^\w.-]", requirement, maxsplit=1)[0]
        try:
            found.append(_package(name, requirement))
        except importlib.metadata.PackageNotFoundError:
            found.append(Check(name, "fail", "missing", f"pip install '{requirement}'"))
    return found


def _package(name: str, requirement: str) -> Check:
    version = importlib.metadata.version(name)
    try:
        from packaging.requirements import Requirement
    except ImportError:
        return Check(name, "ok", version)
    if Requirement(requirement).specifier.contains(version, prereleases=True):
        return Check(name, "ok", version)
    return Check(name, "warn", f"{version}, not {requirement}", f"pip install '{requirement}'")


def _processor() -> list[Check]:
    cores = usable_cores()
    threads = os.environ.get("OMP_NUM_THREADS", "not set")
    return [
        Check("cores", "ok", f"{cores} usable of {os.cpu_count()}"),
        Check("threads", "ok", f"--threads 1 a process; OMP_NUM_THREADS {threads}"),
    ]


def _compiled() -> Check:
    """Where machine code is kept."""
    if PLACE and os.environ.get(MADE) != PLACE:
        return Check("compiled code", "ok", f"kept in {PLACE}")
    how = "for one run only" if PLACE else "nowhere"
    found = f"kept {how}: neither the package nor the user's cache is writable"
    return Check("compiled code", "warn", found, f"export {VARIABLE}=FOLDER")


def _torch() -> list[Check]:
    """The GPU, and what `precision: auto` stands for."""
    try:
        import torch
    except ImportError as reason:
        return [Check("gpu", "fail", f"torch cannot be imported: {reason}", "pip install torch")]
    from elast_cli.models.precision import resolved

    there = torch.cuda.is_available()
    gpu = torch.cuda.get_device_name(0) if there else _NO_GPU
    auto = resolved("auto", "cuda" if there else "cpu")
    why = "native here" if auto == "bfloat16" else "bfloat16 is not native here"
    instructions = torch.backends.cpu.get_cpu_capability()
    return [
        Check("gpu", "ok", gpu),
        Check("instructions", "ok", f"{instructions} on the CPU"),
        Check("precision", "ok", f"auto is {auto}: {why}"),
    ]


def _robot_tasks() -> Check:
    """Whether the simulation of the robot tasks works, in a process of its own."""
    reason = _error(_ROBOT, os.environ)
    if reason is None:
        return Check("robot tasks", "ok", "an image of reach was drawn")
    return Check("robot tasks", "warn", reason, "pip install --force-reinstall mujoco metaworld")


def _renderers() -> list[Check]:
    """MuJoCo's GL back ends, each in its own process: a missing library breaks the import."""
    found = []
    for backend, packages in _GL_PACKAGES.items():
        reason = _error(_RENDER, {**os.environ, "MUJOCO_GL": backend})
        if reason is None:
            found.append(Check(f"renderer {backend}", "ok", "works"))
        else:
            remedy = f"apt-get install {packages} (optional)"
            found.append(Check(f"renderer {backend}", "warn", reason, remedy))
    return found


def _error(script: str, environment: Mapping[str, str]) -> str | None:
    """Why a script fails in a process of its own; None if it does not."""
    command = [sys.executable, "-P", "-c", script]  # nothing from the working directory
    path = os.pathsep.join(filter(None, [str(_SOURCES), environment.get("PYTHONPATH")]))
    environment = {**environment, "PYTHONPATH": path}
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=120, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as reason:
        return str(reason)
    lines = done.stderr.strip().splitlines()
    return None if done.returncode == 0 else (lines[-1] if lines else f"exit {done.returncode}")


def _home() -> Path:
    return expanded(os.environ.get("ELAST_HOME") or ".").absolute()


def _there(home: Path) -> Path:
    """The home, or the folder in which it would be made: the first above it that exists."""
    return next(folder for folder in (home, *home.parents) if os.path.lexists(folder))


def _store() -> Check:
    home = _home()
    there = _there(home)
    try:
        with tempfile.NamedTemporaryFile(dir=there, prefix=".elast-doctor-"):
            state = "is writable" if there == home else f"will be made: {there} is writable"
            return Check("store", "ok", f"{home} {state}")
    except OSError as reason:
        remedy = "export ELAST_HOME=/a/writable/folder"
        return Check("store", "fail", f"{home}: {reason.strerror}", remedy)


def _locks() -> Check:
    """Whether the store's disk has file locks."""
    there = _there(_home())
    try:
        if supported(there):
            return Check("locks", "ok", "file locks work there")
    except OSError as reason:
        return Check("locks", "warn", f"{there}: {reason.strerror}")
    found = f"{there} has none; files that are created exclusively stand for them"
    return Check("locks", "warn", found, "export ELAST_HOME=/a/local/disk")


def _disk() -> Check:
    try:
        free = shutil.disk_usage(_there(_home())).free
    except OSError as reason:
        return Check("disk", "warn", str(reason.strerror))
    value = f"{free / 1e9:.1f} GB free"
    if free < LEAST_FREE:
        return Check("disk", "warn", value, "elast gc, or export ELAST_HOME=/a/larger/disk")
    return Check("disk", "ok", value)
