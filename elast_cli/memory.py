"""How much memory this process may still take."""

from __future__ import annotations

import resource
from pathlib import Path

GROUP = Path("/sys/fs/cgroup")  # of a container, as it sees itself


def available() -> float:
    """Bytes free by machine, container and `ulimit -v`; infinite where none of them tells."""
    return min(_machine(), _group(), _limit())


def _machine() -> float:
    """Free memory of the machine."""
    return _kilobytes(Path("/proc/meminfo"), "MemAvailable:")


def _group() -> float:
    """What is left of a container's share (control groups, version 2 or 1)."""
    left = float("inf")
    for most, used in (
        (GROUP / "memory.max", GROUP / "memory.current"),
        (GROUP / "memory/memory.limit_in_bytes", GROUP / "memory/memory.usage_in_bytes"),
    ):
        try:
            left = min(left, int(most.read_text()) - int(used.read_text()))
        except (OSError, ValueError):  # ValueError: "max"
            continue
    return left


def _limit() -> float:
    """What is left of the address space that the shell allows."""
    most = resource.getrlimit(resource.RLIMIT_AS)[0]
    if most == resource.RLIM_INFINITY:
        return float("inf")
    used = _kilobytes(Path("/proc/self/status"), "VmSize:")
    return most - used if used < float("inf") else float(most)


def _kilobytes(path: Path, name: str) -> float:
    """An entry of a file of the system, in bytes; infinite if it is not there."""
    try:
        for line in path.read_text().splitlines():
            if line.startswith(name):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError, IndexError):
        pass
    return float("inf")
