"""The Panda: its model against independent computations, and its actions."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from numpy.typing import NDArray

from gpusimbench import open_recording
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.recorder.scenes.emit.mjcf import emit_mjcf
from gpusimbench.recorder.scenes.franka import PANDA, START, franka
from gpusimbench.schemas.action_generator import Streams, read_generator
from tests.conftest import SMALL, Command

G = 9.81

# Franka Emika's published table, after Craig: a [m], d [m], alpha [rad] of joints 1 to 7, then the flange.
DH = (
    (0.0, 0.333, 0.0),
    (0.0, 0.0, -math.pi / 2),
    (0.0, 0.316, math.pi / 2),
    (0.0825, 0.0, math.pi / 2),
    (-0.0825, 0.384, -math.pi / 2),
    (0.0, 0.0, math.pi / 2),
    (0.088, 0.0, math.pi / 2),
    (0.0, 0.107, 0.0),
)


def frames(angles: Any) -> list[NDArray[np.float64]]:
    """Poses 4x4 of links 1 to 7 and the flange by the published table; no code of the model is used."""
    pose = np.eye(4)
    found = []
    for (a, d, alpha), q in zip(DH, (*angles, 0.0), strict=True):
        ca, sa, cq, sq = math.cos(alpha), math.sin(alpha), math.cos(q), math.sin(q)
        pose = pose @ np.array(
            [[cq, -sq, 0, a], [sq * ca, cq * ca, -sa, -d * sa], [sq * sa, cq * sa, ca, d * ca], [0, 0, 0, 1]]
        )
        found.append(pose)
    return found


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    """The arm in MuJoCo."""
    return mujoco.MjModel.from_xml_string(emit_mjcf(franka(), dt=0.001, option={}, geom={}))


def _angles(rng: np.random.Generator) -> NDArray[np.float64]:
    return np.array([rng.uniform(j.lower, j.upper) for j in PANDA.joints()])


def test_kinematics_are_the_published_ones(model: mujoco.MjModel) -> None:
    """Place every link where the published Denavit-Hartenberg table does, at any joint angles."""
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    for _ in range(50):
        data.qpos[:] = _angles(rng)
        mujoco.mj_kinematics(model, data)
        expected = frames(data.qpos)
        for number in range(1, 8):
            body = model.body(f"link{number}").id
            assert np.allclose(data.xpos[body], expected[number - 1][:3, 3], atol=1e-12)
            assert np.allclose(data.xmat[body].reshape(3, 3), expected[number - 1][:3, :3], atol=1e-12)
        assert np.allclose(data.xpos[model.body("hand").id], expected[7][:3, 3], atol=1e-12)


def test_limits_and_reach() -> None:
    """Have the published limits and a reach of 0.855 m from the shoulder to the flange's axis."""
    joints = PANDA.joints()
    assert [j.max_torque for j in joints] == [87.0] * 4 + [12.0] * 3
    assert [j.max_velocity for j in joints] == [2.175] * 4 + [2.61] * 3
    assert all(j.lower < s < j.upper for j, s in zip(joints, START, strict=True))
    rng = np.random.default_rng(1)
    shoulder = np.array([0.0, 0.0, 0.333])
    wrist = [np.linalg.norm(frames(_angles(rng))[6][:3, 3] - shoulder) for _ in range(20_000)]
    assert 0.75 < max(wrist) < 0.855


def _potential(angles: NDArray[np.float64]) -> float:
    poses = dict(zip((f"link{n}" for n in range(1, 8)), frames(angles), strict=False))
    quarter = math.pi / 4
    turn = np.eye(4)
    turn[:2, :2] = [[math.cos(quarter), math.sin(quarter)], [-math.sin(quarter), math.cos(quarter)]]
    poses["hand"] = frames(angles)[7] @ turn
    energy = 0.0
    for link in PANDA.links:
        if link.name in poses:
            energy += link.inertial.mass * G * (poses[link.name] @ [*link.inertial.centre, 1.0])[2]
    return energy


def test_gravity_torques(model: mujoco.MjModel) -> None:
    """Need the torques that the gradient of the potential energy gives, and no more than the motors have."""
    data = mujoco.MjData(model)
    rng = np.random.default_rng(2)
    for _ in range(20):
        data.qpos[:] = _angles(rng)
        data.qvel[:] = 0
        mujoco.mj_forward(model, data)
        step = 1e-6 * np.eye(7)
        gradient = [(_potential(data.qpos + s) - _potential(data.qpos - s)) / 2e-6 for s in step]
        assert np.allclose(data.qfrc_bias, gradient, atol=1e-6)
        assert all(abs(t) < j.max_torque for t, j in zip(gradient, PANDA.joints(), strict=True))


def test_masses_and_inertias_are_physical() -> None:
    """Have positive masses and inertias that a rigid body can have; 17.1 kg move."""
    for link in PANDA.links:
        xx, yy, zz, xy, xz, yz = link.inertial.inertia
        principal = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert (principal > 0).all(), link.name
        assert principal[2] < principal[0] + principal[1] + 1e-9, link.name
    assert sum(link.inertial.mass for link in PANDA.links[1:]) == pytest.approx(16.82, abs=0.01)


def test_energy_is_kept_without_motors(model: mujoco.MjModel) -> None:
    """Swing freely, without servo, friction or contact, and keep the energy to 1e-4 of what moves."""
    free = mujoco.MjModel.from_xml_string(emit_mjcf(franka(), dt=0.0002, option={"integrator": "RK4"}, geom={}))
    free.dof_damping[:] = 0
    free.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    free.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    data = mujoco.MjData(free)
    data.qpos[:] = START
    energies = []
    for _ in range(2500):
        mujoco.mj_step(free, data)
        energies.append(data.energy.copy())
    total = np.sum(energies, axis=1)
    moved = np.max([kinetic for _, kinetic in energies])
    assert moved > 1.0
    assert np.ptp(total) < 1e-4 * moved


def test_self_collision(model: mujoco.MjModel) -> None:
    """Touch nothing at the start, collide in some poses, and never between neighbours."""
    data = mujoco.MjData(model)
    data.qpos[:] = START
    mujoco.mj_forward(model, data)
    assert data.ncon == 0
    rng = np.random.default_rng(3)
    pairs = set()
    hits = 0
    order = [link.name for link in PANDA.links]
    for _ in range(2000):
        data.qpos[:] = _angles(rng)
        mujoco.mj_fwdPosition(model, data)
        hits += data.ncon > 0
        for contact in data.contact:
            names = [model.body(model.geom_bodyid[g]).name for g in (contact.geom1, contact.geom2)]
            pairs.add(tuple(sorted(names, key=order.index)))
    assert 0.02 < hits / 2000 < 0.3
    assert ("link5", "hand") in pairs
    assert all(order.index(b) - order.index(a) > 2 for a, b in pairs)


@given(st.integers(0, 2**63), st.integers(1, 9), st.integers(0, 500), st.integers(1, 9))
def test_actions_depend_on_seed_env_and_step_alone(seed: int, n_env: int, first: int, count: int) -> None:
    """Give the same target whatever else is drawn with it, within the limits."""
    actions = franka().actions
    block = actions.draw(seed, n_env=n_env, first_step=first, n_step=count)
    assert block.shape == (count, n_env, 7)
    assert block.dtype == np.float32
    assert (block >= np.float32(actions.lower)).all()
    assert (block <= np.float32(actions.upper)).all()
    alone = actions.draw(seed, n_env=20, first_step=first + count - 1, n_step=1)
    assert np.array_equal(block[-1], alone[0, :n_env])


@given(st.integers(0, 2**63), st.integers(2, 9), st.integers(0, 20))
def test_streams_of_actions(seed: int, n_env: int, begun: int) -> None:
    """Give an environment the actions of another, and begin them anew, as the streams say."""
    actions = franka().actions
    usual = actions.draw(seed, n_env=n_env, first_step=0, n_step=30)
    anew = np.zeros(n_env, dtype=np.uint32)
    anew[0] = begun
    env = np.roll(np.arange(n_env, dtype=np.uint32), -1)
    block = actions.draw(seed, n_env=n_env, first_step=0, n_step=30, streams=Streams(env, anew))
    assert np.array_equal(block[:, 1:], np.roll(usual, -1, axis=1)[:, 1:])
    assert np.array_equal(block[:begun, 0], usual[:begun, 1])
    assert np.array_equal(block[begun:, 0], usual[: 30 - begun, 1])


def test_actions_are_uniform_and_independent() -> None:
    """Fill the limits evenly, without correlation between neighbours in step, env or joint."""
    actions = franka().actions
    block = actions.draw(0, n_env=64, first_step=0, n_step=400).astype(np.float64)
    unit = (block - actions.lower) / np.subtract(actions.upper, actions.lower)
    counts, _ = np.histogram(unit, bins=50, range=(0, 1))
    expected = unit.size / 50
    assert ((counts - expected) ** 2 / expected).sum() < 95  # chi-squared, 49 degrees of freedom, p = 1e-4
    for a, b in ((unit[1:], unit[:-1]), (unit[:, 1:], unit[:, :-1]), (unit[..., 1:], unit[..., :-1])):
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 0.01
    assert not np.array_equal(block, actions.draw(1, n_env=64, first_step=0, n_step=400))


def test_a_recording_of_the_arm(gsb_record: Command, gsb_eval: Command, tmp_path: Path) -> None:
    """Record joints and actions; the recorded actions are the drawn ones, and environments differ by them."""
    done = gsb_record("--sim", "mujoco", "--scene", "franka", "--n-env", 3, "--runs", 2, *SMALL, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    first, second = (open_recording(p) for p in done.stdout.split())
    verify(first)
    qpos = first.state("robot", "qpos")
    assert qpos.shape == (101, 3, 7, 1)
    assert qpos.field.unit == "rad"
    assert np.allclose(qpos[0, :, :, 0], START)
    limits = [(j.lower - 0.1, j.upper + 0.1) for j in PANDA.joints()]
    assert all(low < q.min() and q.max() < high for q, (low, high) in zip(qpos[...].T[0], limits, strict=True))
    assert np.abs(first.state("robot", "qvel")[50]).max() > 0.5
    topic = "/action/joint_target/000000"
    with first.path.open("rb") as stream:
        messages = list(make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages(topics=[topic]))
    assert messages[0].channel.metadata["unit"] == "rad"
    assert [(m.encoding, m.steps, m.envs, len(m.data)) for _, _, _, m in messages] == [(2, 50, 3, 0)] * 2
    actions = franka().actions
    assert actions is not None
    assert read_generator(messages[0].channel.metadata["generator"]) == (actions, 0)
    drawn = actions.draw(0, n_env=3, first_step=0, n_step=100)
    assert np.array_equal(first.actions("joint_target"), drawn)
    assert first.action_names == ("joint_target",)
    found, again = first.fingerprints("capture"), second.fingerprints("capture")
    assert np.array_equal(found.hashes, again.hashes)
    assert len(set(found.hashes[-1].tolist())) == 3
    evaluated = gsb_eval(first.path, second.path, "--json", "-", code=0)
    (group,) = json.loads(evaluated.stdout)["groups"]
    changed = group["metrics"]["capture_changes_states"]
    assert (changed["value"], changed["n"]) == (0, 2), "the timed phase had the same actions"
    assert "no positions of free bodies were recorded" in evaluated.stdout
    why = group["metrics"]["distinct_envs"]["value_missing"]
    assert why.startswith("the environments were given different actions")
