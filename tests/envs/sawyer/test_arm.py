"""The arm: it goes where it is sent, comes to rest, and has one posture for each place."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from elast_cli.envs import registry
from elast_cli.envs.random_policy import RandomPolicy
from elast_cli.envs.sawyer import scene
from elast_cli.envs.sawyer.arm import SawyerTask
from elast_cli.envs.sawyer.physics import mujoco
from elast_cli.errors import ConfigError, UnavailableError


def made(name: str = "reach", **config: object) -> SawyerTask:
    env = registry.make(name, config)
    assert isinstance(env, SawyerTask)
    env.np_random = np.random.default_rng(0)
    env.reset(options={"collect": True})
    return env


def walked(env: SawyerTask, steps: int, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(seed)
    policy = RandomPolicy(3)
    policy.reset(rng)
    seen = []
    for _ in range(steps):
        env.step(policy.act(rng))
        seen.append((env.hand, env.data.qpos[: scene.JOINTS].copy()))
    return seen


def test_the_hand_goes_where_it_is_sent() -> None:
    env = made()
    errors = []
    rng = np.random.default_rng(0)
    for _ in range(100):
        action = rng.uniform(-1, 1, 3).astype(np.float32)
        low, high = env.config.box
        wanted = np.clip(env.hand + action * env.config.displacement, low, high)
        env.step(action)
        errors.append(np.linalg.norm(env.hand - wanted))
    assert np.median(errors) < 0.003


def test_an_idle_arm_stays_where_it_is() -> None:
    env = made()
    for _ in range(10):
        env.step(np.zeros(3, dtype=np.float32))
    before = env.hand
    for _ in range(30):
        env.step(np.zeros(3, dtype=np.float32))
    assert np.linalg.norm(env.hand - before) < 0.001


def test_one_place_has_one_posture() -> None:
    env = made()
    one, other = walked(env, 300, seed=1), walked(env, 300, seed=2)
    gaps = [
        np.abs(joints - nearest[1]).max()
        for hand, joints in one
        for nearest in [min(other, key=lambda entry: float(np.linalg.norm(entry[0] - hand)))]
        if np.linalg.norm(nearest[0] - hand) < 0.02
    ]
    assert len(gaps) > 20
    assert np.median(gaps) < 0.1  # rad; without the torque: 0.84


def test_the_arm_is_metaworlds() -> None:
    ours = made("button")
    path = scene._folder() / "sawyer_button_press.xml"
    theirs = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(theirs)
    data.qpos[:] = ours.data.qpos
    mujoco.mj_forward(theirs, data)
    np.testing.assert_allclose(data.body("hand").xpos, ours.hand, atol=1e-9)


def test_a_world_of_another_mujoco_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"one of mujoco 2\.0\.0, and .* is installed"):
        registry.make("reach", {"mujoco": "2.0.0"})


def test_a_box_has_a_low_and_a_high_corner() -> None:
    with pytest.raises(ConfigError, match="low corner must be below"):
        registry.make("reach", {"box": [[0.1, 0.5, 0.1], [0.0, 0.6, 0.2]]})


def test_a_camera_does_not_look_straight_down() -> None:
    with pytest.raises(ConfigError, match="straight above or below"):
        registry.make("reach", {"camera": {"place": [0, 0.6, 1], "target": [0, 0.6, 0]}})


def test_an_unknown_scene_is_one_line() -> None:
    with pytest.raises(UnavailableError, match=r"metaworld has no scene nothing.*pip install"):
        scene.load("nothing")


def test_a_damaged_scene_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene, "_folder", lambda: tmp_path)
    (tmp_path / "odd.xml").write_text("<mujoco><oops")
    with pytest.raises(UnavailableError, match=r"scene odd.xml is not the one.*pip install"):
        scene.load("odd")
    (tmp_path / "odd.xml").write_text("<mujoco/>")  # without an arm
    with pytest.raises(UnavailableError, match=r"scene odd.xml is not the one.*pip install"):
        scene.load("odd")


@pytest.mark.parametrize(
    ("name", "config", "words"),
    [
        ("reach", {"substeps": 1_000_000_000}, "substeps.*less than or equal"),
        ("reach", {"displacement": 1e300}, "displacement.*less than or equal"),
        ("reach", {"box": [[-1e9, -1e9, -1e9], [1e9, 1e9, 1e9]]}, "box.*greater than or equal"),
        ("reach", {"camera": {"fovy": 1e-300}}, "fovy.*greater than or equal"),
        ("reach", {"camera": {"target": [1e200, 0, 0]}}, "target.*less than or equal"),
        ("button", {"depth": [0.05, 0.025]}, "the first must not exceed the second"),
        ("hammer", {"lying": [[0.04, -0.08], [0.45, 0.56]]}, "the first must not exceed"),
    ],
)
def test_a_world_that_cannot_be_is_one_line(
    name: str, config: dict[str, object], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        registry.make(name, config)


def test_a_box_out_of_reach_is_one_line() -> None:
    with pytest.raises(ConfigError, match="no free place for the hand"):
        made(box=((1.0, 1.0, 1.0), (2.0, 2.0, 2.0)), substeps=4)


@pytest.mark.parametrize("asked", ["garbage", "osmesa"])
def test_mujoco_is_imported_whatever_opengl_is_asked_for(asked: str) -> None:
    program = "import os; from elast_cli.envs.sawyer.physics import mujoco as m; "
    program += "print(m.__version__, os.environ['MUJOCO_GL'])"
    environment = {**os.environ, "MUJOCO_GL": asked}
    run = [sys.executable, "-c", program]
    done = subprocess.run(run, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [mujoco.__version__, asked]
    assert done.stderr == ""


def test_a_broken_mujoco_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "mujoco.py").write_text("raise ImportError('libmujoco.so.3: no such file')")
    path = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    run = [sys.executable, "-m", "elast_cli", "collect", "--env", "reach", "--n", "20"]
    environment = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(run, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 69
    assert re.fullmatch("elast: MuJoCo cannot be .*libmujoco.*; run: pip install .*\n", done.stderr)


def test_unstable_physics_are_one_line_and_leave_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    env = made()
    env.data.qvel[:] = 1e12
    with pytest.raises(ConfigError, match="physics became unstable"):
        env.step(np.zeros(3, dtype=np.float32))
    assert list(tmp_path.iterdir()) == []
