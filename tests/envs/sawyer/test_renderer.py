"""Our renderer against MuJoCo's rays, against OpenGL where it is, and against arithmetic."""

from __future__ import annotations

import gc

import numpy as np
import pytest

from elast_cli.envs import registry
from elast_cli.envs.sawyer import mesh, raster, renderer
from elast_cli.envs.sawyer.arm import SawyerTask
from elast_cli.envs.sawyer.physics import has_opengl, mujoco
from elast_cli.errors import UnavailableError

TASKS = ("reach", "button", "drawer", "hammer")


def made(name: str, **config: object) -> SawyerTask:
    env = registry.make(name, config)
    assert isinstance(env, SawyerTask)
    env.np_random = np.random.default_rng(0)
    env.reset(options={"collect": True})
    return env


def volume(shape: mesh.Mesh) -> float:
    """By the divergence theorem; positive only if faces turn anticlockwise seen from outside."""
    a, b, c = (shape.points[shape.faces[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def test_primitives_have_their_volumes() -> None:
    spec = mujoco.MjSpec()
    sizes = {
        mujoco.mjtGeom.mjGEOM_BOX: ([0.1, 0.2, 0.3], 8 * 0.006),
        mujoco.mjtGeom.mjGEOM_CYLINDER: ([0.1, 0.2, 0], np.pi * 0.01 * 0.4),
        mujoco.mjtGeom.mjGEOM_SPHERE: ([0.1, 0, 0], 4 / 3 * np.pi * 0.001),
        mujoco.mjtGeom.mjGEOM_CAPSULE: ([0.1, 0.2, 0], np.pi * (0.01 * 0.4 + 4 / 3 * 0.001)),
    }
    for kind, (size, _) in sizes.items():
        spec.worldbody.add_geom(type=kind, size=size)
    model = spec.compile()
    for geom, (_, expected) in enumerate(sizes.values()):
        assert volume(mesh.of_geom(model, geom)) == pytest.approx(expected, rel=0.05)


def test_merging_points_keeps_the_volume() -> None:
    env = made("reach")
    for geom in range(env.model.ngeom):
        if env.model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            fine = mesh.of_geom(env.model, geom, cell=1e-9)
            coarse = mesh.of_geom(env.model, geom)
            assert len(coarse.faces) <= len(fine.faces)
            assert volume(coarse) == pytest.approx(volume(fine), rel=0.1)


@pytest.mark.parametrize("name", TASKS)
def test_what_is_nearest_is_what_mujocos_rays_hit(name: str) -> None:
    env = made(name)
    ours = env.renderer
    assert isinstance(ours, renderer.RasterRenderer)
    inverse = ours.depth(env.data)
    camera = env.config.camera
    turned = renderer.turn(camera)
    size = inverse.shape[0]
    focal = size / 2 / np.tan(np.radians(camera.fovy) / 2)
    group, hit = np.array([1, 1, 1, 0, 0, 0], dtype=np.uint8), np.zeros(1, dtype=np.int32)
    wrong = 0
    places = np.random.default_rng(0).integers(0, size, (400, 2))
    for row, column in places:
        ray = np.array([column + 0.5 - size / 2, size / 2 - row - 0.5, -focal])
        unit = ray / np.linalg.norm(ray)
        far = mujoco.mj_ray(
            env.model, env.data, np.array(camera.place), turned.T @ unit, group, 1, -1, hit
        )
        nothing = far < 0 or env.model.geom(hit[0]).name == "floor"  # which is not drawn
        expected = 0.0 if nothing else 1 / (far * -unit[2])
        wrong += abs(inverse[row, column] - expected) > 0.01 * max(expected, 1e-9)
    assert wrong <= 0.03 * len(places)  # edges, and points that were merged


def test_equal_states_have_equal_images_and_others_differ() -> None:
    env = made("hammer")
    state, image = env.state, env.frame()
    env.step(np.array([1, 0, 0, 1], dtype=np.float32))
    assert (env.frame() != image).any()
    env.set_state(state, np.zeros(0, dtype=np.float32))
    again = env.frame()
    assert np.abs(again.astype(int) - image).max() <= 2  # states are stored in single precision


def test_a_millimetre_is_seen() -> None:
    env = made("button")
    before = env.frame().astype(int)
    env._place(env.hand + np.array([0.001, 0, 0]))
    assert np.abs(env.frame().astype(int) - before).max() >= 3


def test_means_are_rounded_exactly() -> None:
    samples = np.zeros((4, 4, 3), dtype=np.uint8)
    samples[0, 0] = 255
    samples[2:, 2:] = 7
    image = raster.averaged(samples, 2)
    assert image[0, 0].tolist() == [64, 64, 64]  # 63.75
    assert image[1, 1].tolist() == [7, 7, 7]


def test_a_hand_casts_its_shadow_straight_below() -> None:
    env = made("reach")
    env._place(np.array([0.0, 0.6, 0.2]))
    lit = env.frame().astype(int)
    table = renderer.turn(env.config.camera) @ (np.array([0.0, 0.6, 0.0]) - env.config.camera.place)
    focal = 32 / np.tan(np.radians(env.config.camera.fovy) / 2)
    column, row = 32 - focal * table[0] / table[2], 32 + focal * table[1] / table[2]
    beside = lit[int(row), int(column) + 12]
    assert (lit[int(row), int(column)] < 0.8 * beside).all()


def test_opengl_sees_the_same_scene() -> None:
    if not has_opengl("egl"):
        pytest.skip("no EGL on this machine")
    for name in TASKS:
        ours = made(name).frame().astype(float).mean(2).ravel()
        theirs = made(name, renderer="egl").frame().astype(float).mean(2).ravel()
        assert np.corrcoef(ours, theirs)[0, 1] > 0.6


def test_a_missing_opengl_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("elast_cli.envs.sawyer.opengl.has_opengl", lambda _: False)
    with pytest.raises(UnavailableError, match=r"library is not installed .* libosmesa6"):
        made("reach", renderer="osmesa")


@pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")
def test_an_opengl_that_fails_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    if not has_opengl("egl"):
        pytest.skip("no EGL on this machine")
    monkeypatch.setenv("MUJOCO_EGL_DEVICE_ID", "99")
    monkeypatch.setattr("mujoco.egl.EGL_DISPLAY", None)
    with pytest.raises(UnavailableError, match=r"renderer egl: .*MUJOCO_EGL_DEVICE_ID.*libegl1"):
        made("reach", renderer="egl")
    gc.collect()
