from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from elast_cli.config import JsonDict
from elast_cli.control.collection import collect_episode
from elast_cli.data.chunks import CHUNK_ROWS
from elast_cli.data.layout import column_digests
from elast_cli.data.shards import shard_path
from elast_cli.envs.block.param import BlockParam
from elast_cli.errors import DataError, MissingInputError, UnavailableError, UsageError
from elast_cli.models.parts import kinds
from elast_cli.progress import Silent
from elast_cli.stages import collect, presets, train
from elast_cli.stages.job import Job, RecipeJob, resolve_device
from elast_cli.stages.resolve import needs, resolve
from elast_cli.store.manifest import Ref
from elast_cli.store.run import Run
from elast_cli.store.store import Store

ENV = "block-s"


class Notes(Silent):
    """Progress that remembers what was said."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def note(self, text: str) -> None:
        self.said.append(text)


@pytest.fixture
def job(home: Path) -> Job:
    config = presets.load("quick", ENV, ["collect.n=60", "collect.episode_steps=10"])
    return Job(store=Store(home), env=ENV, preset="quick", config=config)


def publish(job: Job, kind: str, inputs: Mapping[str, Ref], *, mark: int = 0) -> Ref:
    """A stand-in artifact; `mark` sets it apart from others of the same inputs."""

    def make(run: Run) -> JsonDict:
        (run.staging / "file").write_text(str(mark))
        return {}

    recipe = job.recipe(kind, {"mark": mark}, inputs, algorithm_version=1)
    return RecipeJob(job, recipe, inputs, make).carry_out()


def lineage(job: Job, *, mark: int = 0) -> dict[str, Ref]:
    """A whole chain of stand-ins."""
    dataset = publish(job, "dataset", {}, mark=mark)
    encoder = publish(job, "encoder", {"dataset": dataset})
    both = {"dataset": dataset, "encoder": encoder}
    ensemble = publish(job, "ensemble", both)
    density = publish(job, "density", both)
    policy = publish(job, "policy", {**both, "ensemble": ensemble})
    return {**both, "ensemble": ensemble, "density": density, "policy": policy}


MODELS = ("encoder", "ensemble", "density", "policy")


def test_the_highest_versions_that_fit_are_taken_and_named(job: Job) -> None:
    lineage(job)
    newer = lineage(job, mark=1)
    notes = Notes()
    found = resolve(replace(job, progress=notes), MODELS)
    assert found == {role: newer[role] for role in MODELS}
    assert "block-s/encoder/v2" in notes.said[0]


def test_an_incomplete_newer_lineage_is_not_mixed_with_an_older_one(job: Job) -> None:
    older = lineage(job)
    dataset = publish(job, "dataset", {}, mark=1)
    publish(job, "encoder", {"dataset": dataset})
    assert resolve(job, MODELS) == {role: older[role] for role in MODELS}
    assert resolve(job, ("encoder",)) == {"encoder": Ref(ENV, "encoder", 2)}


def test_given_artifacts_choose_the_rest(job: Job) -> None:
    older = lineage(job)
    lineage(job, mark=1)
    given = replace(job, given={"policy": older["policy"]})
    assert resolve(given, MODELS) == {role: older[role] for role in MODELS}


def test_other_seeds_and_presets_are_never_taken(job: Job) -> None:
    lineage(replace(job, seed=1))
    lineage(replace(job, preset="standard"))
    with pytest.raises(
        MissingInputError, match=r"run: elast collect --env block-s --preset quick$"
    ):
        resolve(job, ("dataset",))
    with pytest.raises(MissingInputError, match=r"--preset paper --seed 4$"):
        resolve(replace(job, seed=4, preset="paper"), ("dataset",))


def test_what_is_missing_is_named_with_its_command(job: Job) -> None:
    dataset = publish(job, "dataset", {})
    encoder = publish(job, "encoder", {"dataset": dataset})
    given = replace(job, given={"encoder": encoder})
    with pytest.raises(MissingInputError) as caught:
        resolve(given, MODELS)
    assert "elast train-ensemble --env block-s --preset quick --encoder block-s/encoder/v1" in str(
        caught.value
    )


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (lambda job: replace(job, seed=1), DataError, "--preset quick --seed 0"),
        (lambda job: replace(job, preset="paper"), DataError, "never mixed"),
        (lambda job: replace(job, env="other"), DataError, "of environment block-s, not other"),
    ],
)
def test_a_given_artifact_of_another_lineage_is_refused(
    job: Job, change: Callable[[Job], Job], error: type[Exception], words: str
) -> None:
    refs = lineage(job)
    with pytest.raises(error, match=words):
        resolve(replace(change(job), given={"encoder": refs["encoder"]}), ("encoder",))


def test_given_artifacts_of_two_lineages_are_refused_with_both_digests(job: Job) -> None:
    older, newer = lineage(job), lineage(job, mark=1)
    for roles in (("dataset", "encoder"), ("ensemble", "density"), ("ensemble", "policy")):
        given = {roles[0]: older[roles[0]], roles[1]: newer[roles[1]]}
        with pytest.raises(DataError, match=r"digest \w{12} against \w{12}"):
            resolve(replace(job, given=given), MODELS)


def test_a_ref_of_another_kind_is_a_usage_error(job: Job) -> None:
    refs = lineage(job)
    with pytest.raises(UsageError, match="--encoder block-s/policy/v1: its kind is policy"):
        resolve(replace(job, given={"encoder": refs["policy"]}), ("encoder",))


def test_a_damaged_artifact_is_never_chosen_by_itself(job: Job, home: Path) -> None:
    older = lineage(job)
    newer = lineage(job, mark=1)
    path = job.store.path(newer["dataset"]) / "manifest.yaml"
    path.write_text(path.read_text() + "\n")
    assert resolve(job, ("dataset",)) == {"dataset": older["dataset"]}
    with pytest.raises(DataError):
        resolve(replace(job, given={"dataset": newer["dataset"]}), ("dataset",))


# --- contexts ------------------------------------------------------------------------------------

PARAM = "block-param"


@pytest.fixture
def param_job(job: Job) -> Job:
    """A job in an environment whose obstacles change with the episode."""
    return replace(job, env=PARAM, config=presets.load("quick", PARAM))


def param_lineage(job: Job, *, mark: int = 0) -> dict[str, Ref]:
    """A whole chain of stand-ins with contexts."""
    made: dict[str, Ref] = {}
    for role in kinds():
        inputs = {need: made[need] for need in needs(job, role)}
        made[role] = publish(job, role, inputs, mark=mark if role == "dataset" else 0)
    return made


@pytest.mark.parametrize("role", kinds())
def test_every_learned_part_is_made_from_the_context_where_there_is_one(
    job: Job, param_job: Job, role: str
) -> None:
    assert ("context" in needs(param_job, role)) == (role not in ("dataset", "context"))
    assert "context" not in needs(job, role)


def test_the_context_is_found_with_its_lineage_and_dropped_where_there_is_none(
    job: Job, param_job: Job
) -> None:
    param_lineage(param_job)
    newer = param_lineage(param_job, mark=1)
    roles = ("context", *MODELS)
    assert resolve(param_job, roles) == {role: newer[role] for role in roles}
    lineage(job)
    assert set(resolve(job, roles)) == set(MODELS)


def test_a_missing_context_is_named_with_its_command(param_job: Job) -> None:
    with pytest.raises(MissingInputError, match="run: elast collect --env block-param"):
        train.recipe_job(param_job, "context")
    dataset = publish(param_job, "dataset", {})
    command = "run: elast train-context --env block-param --preset quick"
    with pytest.raises(MissingInputError, match=f"no context for block-param.*{command}$"):
        train.recipe_job(param_job, "encoder")
    given = replace(param_job, given={"dataset": dataset})
    with pytest.raises(MissingInputError, match=f"{command} --dataset {dataset}$"):
        train.recipe_job(given, "encoder")


def test_a_context_of_another_lineage_is_refused(param_job: Job) -> None:
    older, newer = param_lineage(param_job), param_lineage(param_job, mark=1)
    for role in ("dataset", "encoder", "policy"):
        given = {"context": older["context"], role: newer[role]}
        with pytest.raises(DataError, match=r"digest \w{12} against \w{12}"):
            resolve(replace(param_job, given=given), MODELS)


def test_an_environment_without_contexts_refuses_them(job: Job) -> None:
    words = "block-s has no contexts.*run: elast train-encoder --env block-s"
    with pytest.raises(UsageError, match=words):
        train.recipe_job(job, "context")
    given = replace(job, given={"context": Ref(ENV, "context", 1)})
    with pytest.raises(UsageError, match=words):
        train.recipe_job(given, "encoder")


def test_a_dataset_without_the_contexts_of_its_environment_is_refused(
    param_job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = "collect.n=60", "collect.episode_steps=10"
    ready = replace(param_job, config=presets.load("quick", PARAM, words))
    with monkeypatch.context() as patch:
        patch.setattr(BlockParam, "context", None)
        collect.recipe_job(ready).carry_out()
    wanted = train.recipe_job(ready, "context")
    with pytest.raises(DataError, match=r"block-param/dataset/v1: .* elast collect .* --force"):
        wanted.carry_out()


# --- collect -------------------------------------------------------------------------------------


def dataset_of(job: Job) -> tuple[Ref, dict[str, str]]:
    ref = collect.recipe_job(job).carry_out()
    return ref, column_digests(job.store.file(ref, collect.DATASET_FILE))


def test_any_number_of_workers_collects_the_same(
    job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(collect, "SHARD_ROWS", 300)  # 14 episodes, whose end is no chunk's end
    config = presets.load("quick", ENV, ["collect.n=900", "collect.episode_steps=20"])
    digests = []
    for workers in (1, 2):
        store = Store(tmp_path / f"with-{workers}")
        ref, columns = dataset_of(replace(job, store=store, config=config, workers=workers))
        digests.append((columns, store.manifest(ref).files))
    assert digests[0] == digests[1]


@pytest.mark.parametrize("rows", [11, 21, 26, 51, 64])
def test_shards_of_short_episodes_are_whole_chunks(rows: int) -> None:
    shares = collect._shares(1000, rows)
    assert [index for share in shares for index in share] == list(range(1000))
    for share in shares[:-1]:
        assert len(share) * rows % CHUNK_ROWS == 0
        assert collect.SHARD_ROWS / 2 < len(share) * rows <= collect.SHARD_ROWS * 2


def test_shards_of_long_episodes_stay_short() -> None:
    assert {len(share) * 501 for share in collect._shares(100, 501)} == {2004}


def test_an_interrupted_collection_ends_the_same_and_runs_only_what_is_missing(
    job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(collect, "SHARD_ROWS", 22)  # two episodes
    _, whole = dataset_of(replace(job, store=Store(tmp_path / "whole")))
    ran: list[int] = []
    original = collect_episode

    def counted(*args: object, index: int, **rest: object) -> object:
        if len(ran) == 5:
            raise KeyboardInterrupt
        ran.append(index)
        return original(*args, index=index, **rest)  # type: ignore[arg-type]  # passed through

    monkeypatch.setattr(collect, "collect_episode", counted)
    with pytest.raises(KeyboardInterrupt):
        dataset_of(job)
    assert job.store.refs() == []
    monkeypatch.setattr(collect, "collect_episode", original)
    notes = Notes()
    _, resumed = dataset_of(replace(job, progress=notes))
    assert resumed == whole
    assert ran == list(range(5))
    assert "4 episodes are there already" in notes.said[0]


def test_shards_that_were_cut_otherwise_are_collected_anew(
    job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, whole = dataset_of(replace(job, store=Store(tmp_path / "whole")))
    with monkeypatch.context() as patch:
        patch.setattr(collect, "SHARD_ROWS", 22)  # two episodes
        patch.setattr(collect, "compact", interrupt)
        with pytest.raises(KeyboardInterrupt):
            dataset_of(job)
    notes = Notes()
    monkeypatch.setattr(collect, "SHARD_ROWS", 33)
    _, resumed = dataset_of(replace(job, progress=notes))
    assert resumed == whole
    assert not notes.said


def interrupt(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


def test_damaged_episodes_are_named_and_fresh_forgets_them(job: Job) -> None:
    wanted = collect.recipe_job(replace(job, fresh=True))
    with job.store.begin(wanted.recipe, parents={}) as run:
        shard_path(run.work, 0).write_text("left by a broken disk")
    with pytest.raises(DataError, match=r"episodes-0000000\.h5: .*--fresh"):
        collect.recipe_job(job).carry_out()
    ref = wanted.carry_out()
    assert job.store.manifest(ref).metrics["episodes"] == 6


def test_threads_and_device_are_no_part_of_a_dataset(job: Job) -> None:
    first = collect.recipe_job(job).carry_out()
    assert collect.recipe_job(replace(job, threads=2, workers=2)).carry_out() == first


@pytest.mark.parametrize(("word", "error"), [("tpu", UsageError), ("cuda", UnavailableError)])
def test_a_device_that_is_not_there_is_an_error(
    word: str, error: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    assert resolve_device("auto") == "cpu"
    with pytest.raises(error):
        resolve_device(word)
