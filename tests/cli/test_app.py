"""The command line as a whole: help, versions, exit codes, pipes, what is imported."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from elast_cli.cli import app as cli
from elast_cli.errors import ElastError
from elast_cli.models.parts import PARTS, word
from elast_cli.store.manifest import Ref
from tests.toys.command_line import COLLECT, ELAST

COMMANDS = [
    "collect",
    *(f"train-{word(kind)}" for kind in PARTS),
    "train-baseline",
    "plan",
    "figure",
    "eval",
    "run",
]
COMMANDS += ["ls", "show", "verify", "compare", "bundle", "unbundle", "gc", "doctor"]


def test_help_loads_nothing_heavy() -> None:
    code = "import sys; from elast_cli.cli import app as cli; assert cli.run(['--help']) == 0; "
    code += "print(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert all(command in done.stdout for command in COMMANDS)
    heavy = {"torch", "gymnasium", "numpy", "pydantic", "h5py", "rich", "numba", "matplotlib"}
    assert not heavy & set(done.stderr.split())


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run([command, "--help"]) == 0
    assert command in capsys.readouterr().out


def test_no_command_prints_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run([]) == 0
    assert "collect" in capsys.readouterr().out


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["--version"]) == 0
    assert capsys.readouterr().out.startswith("elast ")


def test_the_reference_lists_the_exit_code_of_every_error() -> None:
    reference = (Path(__file__).parents[2] / "docs/reference/exit-codes.md").read_text()
    for error in ElastError.__subclasses__():
        assert f"| {error.exit_code} |" in reference
        assert f"`{error.__name__}`" in reference


def test_a_closed_pipe_is_quiet(home: Path) -> None:
    cli.run(COLLECT)
    command = f"{sys.executable} -m elast_cli show block-s/dataset/v1 | true"
    done = subprocess.run(
        ["bash", "-c", f"set -o pipefail; {command}"], cwd=home, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("extra", [[], ["--set", "encoder.fit.steps=3"], ["--set", "cem.topk=3"]])
def test_collecting_and_checking_a_preset_import_no_torch(home: Path, extra: list[str]) -> None:
    run = f"import sys; from elast_cli.cli import app as cli; cli.run({[*COLLECT, *extra]})"
    done = subprocess.run(
        [sys.executable, "-c", f"{run}; print('torch' in sys.modules)"],
        cwd=home,
        capture_output=True,
        text=True,
    )
    assert done.stdout.splitlines() == ["block-s/dataset/v1", "False"], done.stderr


def test_refs_chain_in_a_shell(home: Path) -> None:
    script = f'REF=$({" ".join([*ELAST, *COLLECT])}) && {" ".join(ELAST)} verify "$REF" --json'
    done = subprocess.run(["bash", "-c", script], cwd=home, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)[0]["ref"] == str(Ref("block-s", "dataset", 1))
