"""Rows of an evaluation: one per episode, one per success rate, and the document of both.

A success rate always comes with its Wilson 95 % interval. Rows of several training seeds are pooled
over scenarios; the spread between seeds stands beside (`pc_success_by_seed`, `pc_success_std`).
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Annotated, NamedTuple, Self, TypeVar

from pydantic import Field, JsonValue, model_validator

from elast_cli.config import StrictModel

SCHEMA_VERSION = 1
T = TypeVar("T")
K = TypeVar("K", bound=Hashable)
Interval = Annotated[tuple[float, float], Field(strict=False)]  # JSON has lists only
Percent = Annotated[float, Field(ge=0, le=100)]


class Cell(NamedTuple):
    """One cell of a results table."""

    env: str
    level: str
    method: str


class EpisodeRow(StrictModel):
    """One evaluated episode."""

    env: str
    level: str
    method: str
    train_seed: int
    episode_ix: int = Field(ge=0)
    seed: int  # of the scenario
    success: bool  # inside the success radius at some step
    steps: int | None = Field(ge=0)  # to the first success; None where there is none
    shortest: int | None = Field(ge=0)  # optimal steps to the edge of the success region
    plans: int = Field(ge=0)
    plan_s: float = Field(ge=0)  # mean wall seconds a plan; 0 where nothing plans
    first_plan_s: float = Field(default=0.0, ge=0)  # of the episode's first plan
    reached: int = Field(default=0, ge=0)  # plans whose path ended within the goal radius
    density_calls_per_step: float = Field(default=0.0, ge=0)  # evaluations of ψ
    policy_calls_per_step: float = Field(default=0.0, ge=0)  # evaluations of π
    network_calls_per_step: float = Field(ge=0)
    cpu_s_per_step: float | None = Field(default=None, ge=0)  # of the process, over its episodes
    held: bool  # still inside the radius at the end

    @model_validator(mode="after")
    def _steps_belong_to_a_success(self) -> Self:
        if self.success != (self.steps is not None):
            raise ValueError("steps is a number where success is true, and null elsewhere")
        if self.held and not self.success:
            raise ValueError("held is true only where success is")
        return self


class OverallRow(StrictModel):
    """The episodes of one (env, level, method): of one training seed, or of all of them."""

    env: str
    level: str
    method: str
    train_seed: int | None  # None: all training seeds pooled
    n_episodes: int = Field(ge=1)
    pc_success: Percent
    ci95: Interval  # Wilson, over episodes
    pc_held: Percent
    steps: float | None  # mean over successes
    steps_over_shortest: float | None  # mean ratio over successes
    plan_s: float | None  # mean over plans
    network_calls_per_step: float
    pc_success_by_seed: dict[str, float] | None = None  # pooled rows only
    pc_success_std: float | None = None  # between training seeds, two or more


class Results(StrictModel):
    """The results document: what an evaluation publishes as JSON."""

    schema_version: int = Field(ge=1)
    overall: list[OverallRow]
    per_episode: list[EpisodeRow]
    lineage: dict[str, JsonValue]
    settings: dict[str, JsonValue]
