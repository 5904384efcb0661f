"""How much memory this process may still take, and has taken."""

from __future__ import annotations

import resource
from pathlib import Path

GROUP = Path("/sys/fs/cgroup")  # of a container, as it sees itself


def available() -> float:
    """Bytes free by machine, container and `ulimit -v`; infinite if all are unknown."""
    return min(_machine(), _group(), _limit())


def peak() -> int:
    """Most bytes of memory that this process has had at one time, so far."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _machine() -> float:
    """Free memory of the machine."""
    return _kilobytes(Path("/proc/meminfo"), "MemAvailable:")


def _group() -> float:
    """What is left of a container's share (control groups, version 2 or 1)."""
    left = float("inf")
    for folder, most, used, cached in (
        (GROUP, "memory.max", "memory.current", "inactive_file"),
        (
            GROUP / "memory",
            "memory.limit_in_bytes",
            "memory.usage_in_bytes",
            "total_inactive_file",
        ),
    ):
        try:
            taken = int((folder / used).read_text())
            taken -= int(_entry(folder / "memory.stat", cached))  # files that can be read again
            left = min(left, int((folder / most).read_text()) - taken)
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
    return 1024 * _entry(path, name, missing=float("inf"))


def _entry(path: Path, name: str, *, missing: float = 0) -> float:
    """The number behind a name in a file of the system."""
    try:
        for line in path.read_text().splitlines():
            words = line.split()
            if len(words) > 1 and words[0] == name:
                return int(words[1])
    except (OSError, ValueError):
        pass
    return missing
