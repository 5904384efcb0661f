"""How a job runs."""

from __future__ import annotations

import pytest

from elast_cli.errors import UnavailableError, UsageError
from elast_cli.stages.job import resolve_device


@pytest.mark.parametrize(("word", "error"), [("tpu", UsageError), ("cuda", UnavailableError)])
def test_a_device_that_is_not_there_is_an_error(
    word: str, error: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    assert resolve_device("auto") == "cpu"
    with pytest.raises(error):
        resolve_device(word)
