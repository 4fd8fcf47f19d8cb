"""Re-execute recordings by the engines' own interfaces: what was told and what is recorded, without an adapter.

Nothing of this project reads a recording or steps an engine here. `gsb-record` makes the recordings, and `gsb-share
unpack` writes actions as numbers.
"""

from __future__ import annotations

import io
import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from tests.conftest import call, finished, recorded
from tests.recorder.engines import needed

mujoco = needed("mujoco")

_STEPS = 30
_PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "read-without-our-code.md"
_ONE = ("--n-env", 2, "--runs", 1, "--phases", "capture", "--steps", _STEPS)


class Told:
    """What a stranger reads in a recording: attachments by name, and arrays [step, env, item, width] by field; actions
    [step, env, number], None where there are none."""

    def __init__(self, path: Path) -> None:
        parts: dict[str, list[Any]] = {}
        self.items: dict[str, list[str]] = {}
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            self.files = {attachment.name: attachment.data for attachment in reader.iter_attachments()}
            for _, channel, _, block in reader.iter_decoded_messages():
                name, _, _ = channel.topic.rpartition("/")
                if name.startswith(("/state/", "/action/")) and "/view/" not in name:
                    assert block.encoding == 0
                    shape = (block.steps, block.envs, -1, block.width)
                    numbers = np.array(block.data64) if block.data64 else np.array(block.data, dtype=np.float32)
                    parts.setdefault(name.removeprefix("/state/"), []).append(numbers.reshape(shape))
                    self.items[name.removeprefix("/state/")] = channel.metadata.get("items", "").split(",")
        arrays = {name: np.concatenate(blocks) for name, blocks in parts.items()}
        acted = [arrays.pop(name) for name in list(arrays) if name.startswith("/action/")]
        self.actions = acted[0][:, :, 0] if acted else None
        self.states = arrays
        self.simulation = json.loads(self.files["simulation.json"])
        self.sizes = {buffer["name"]: buffer["asked"] for buffer in self.simulation["buffers"]}

    def model(self) -> Any:
        """The mujoco.MjModel of scene.xml, without the flag that other engines do not know."""
        model = mujoco.MjModel.from_xml_string(self.files["scene.xml"].decode())
        model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        return model


def _told(folder: Path, *arguments: object) -> Told:
    (path,) = recorded(*arguments, *_ONE)
    call("gsb-share", "unpack", path, "--out", folder, code=0)
    (unpacked,) = folder.glob("*.mcap")
    return Told(unpacked)


def _joint_states_equal(told: Told, qpos: Any, qvel: Any) -> None:
    # of a robot, whose joints are all that there is; made states [step, env, number]
    assert len(qpos) == _STEPS + 1
    assert np.ptp(qpos, axis=0).max() > 0.01
    for name, made in (("qpos", qpos), ("qvel", qvel)):
        shown = told.states[f"robot/{name}"][..., 0]
        assert shown.tobytes() == np.asarray(made, dtype=shown.dtype).tobytes(), name


@pytest.mark.parametrize(
    "arguments",
    [("--scene", "inclined-collision"), ("--scene", "franka", "--initial", "random:0.1")],
    ids=["bodies", "robot"],
)
def test_the_program_of_the_page(arguments: tuple[str, ...], tmp_path: Path) -> None:
    """Make the states of a recording again by MuJoCo alone, with the program that the page shows; it notices an engine
    that is told other things: half of the friction, another step, or actions one step late."""
    (program,) = re.findall(r'^```python title="reexecute.py"\n(.*?)^```$', _PAGE.read_text(), re.DOTALL | re.MULTILINE)
    (path,) = recorded("--sim", "mujoco", *arguments, *_ONE)
    call("gsb-share", "unpack", path, "--out", tmp_path, code=0)
    (unpacked,) = tmp_path.glob("*.mcap")
    of_bodies = "franka" not in arguments
    width = 2 * 28 * 10 if of_bodies else 2 * 7 * 2
    said = finished([sys.executable, "-c", program, unpacked]).stdout
    assert said == f"{_STEPS * width} of {_STEPS * width} recorded numbers have the bits of this re-execution\n"
    halved = 'from_xml_string(xml.replace("0.25 0.005", "0.125 0.005"))'
    later = "0 if actions is None else actions[max(step - 2, 0), env]"
    for before, after in (
        ("from_xml_string(xml)", "from_xml_string(xml.replace('timestep=\"0.01\"', 'timestep=\"0.0101\"'))"),
        ("from_xml_string(xml)", halved) if of_bodies else ("0 if actions is None else actions[step - 1, env]", later),
    ):
        assert before in program
        equal, of = re.findall(
            r"\d+", finished([sys.executable, "-c", program.replace(before, after), unpacked]).stdout
        )
        assert int(equal) < int(of)


def test_what_a_velocity_is_of(tmp_path: Path) -> None:
    """Record the velocity of the origin of a body's frame after the step, along the axes of the world, where the centre
    of mass lies elsewhere."""
    model = '<mujoco><option integrator="Euler"/><worldbody><body name="club" pos="0 0 1"><freejoint/>'
    shapes = '<geom size="0.05" pos="0.2 0 0" mass="1"/><geom size="0.02" mass="0.1"/></body></worldbody></mujoco>'
    (tmp_path / "club.xml").write_text(model + shapes)
    start = {
        "bodies/position": np.array([[[0, 0, 1.0]]]), "bodies/orientation": np.array([[[0.8, 0.6, 0, 0]]]),
        "bodies/linear_velocity": np.zeros((1, 1, 3)), "bodies/angular_velocity": np.array([[[1.0, 2.0, 3.0]]]),
    }  # fmt: skip
    file = io.BytesIO()
    np.savez(file, **start)
    (tmp_path / "start.npz").write_bytes(file.getvalue())
    call("gsb-record", "--sim", "mujoco", "--model", tmp_path / "club.xml", "--n-env", 1, "--runs", 1, "--phases",
         "capture", "--steps", 20, "--initial", tmp_path / "start.npz", "--out", tmp_path, code=0)  # fmt: skip
    (path,) = tmp_path.glob("*.mcap")
    told = Told(path)
    dt = json.loads(told.files["provenance.json"])["configuration"]["dt"]
    position, velocity = (told.states[f"bodies/{name}"][:, 0, 0] for name in ("position", "linear_velocity"))
    assert np.diff(position, axis=0) == pytest.approx(dt * velocity[1:], abs=1e-12)
    assert np.abs(np.diff(position, axis=0) - dt * velocity[:-1]).max() > 1e-6  # not those before the step
    spin, orientation = (told.states[f"bodies/{name}"][:, 0, 0] for name in ("angular_velocity", "orientation"))
    assert spin[0] == pytest.approx([1.0, 2.0, 3.0], abs=1e-12)
    turned = np.empty((20, 3))
    for step in range(20):
        before, rotation = orientation[step] * [1, -1, -1, -1], np.empty(4)
        mujoco.mju_mulQuat(rotation, orientation[step + 1], before)
        mujoco.mju_quat2Vel(turned[step], rotation, dt)
    assert turned == pytest.approx(spin[1:], abs=1e-9)


@pytest.mark.slow
def test_mujoco_warp(tmp_path: Path) -> None:
    """Make the states of a robot again by mujoco_warp.step, which holds the actions of the file."""
    wp, mjw = needed("warp"), needed("mujoco_warp")
    told = _told(tmp_path, "--sim", "warp", "--scene", "franka", "--option", "device=cpu")
    assert told.actions is not None
    model = told.model()
    with wp.ScopedDevice("cpu"):
        put = mjw.put_model(model)
        data = mjw.make_data(model, nworld=2, nconmax=told.sizes["nconmax"], njmax=told.sizes["njmax"])
        rows = [told.states["robot/qpos"][0, ..., 0]], [told.states["robot/qvel"][0, ..., 0]]
        data.qpos.assign(rows[0][0])
        data.qvel.assign(rows[1][0])
        for actions in told.actions:
            data.ctrl.assign(actions)
            mjw.step(put, data)
            rows[0].append(data.qpos.numpy().copy())
            rows[1].append(data.qvel.numpy().copy())
    _joint_states_equal(told, *rows)


@pytest.mark.slow
def test_mjx(tmp_path: Path) -> None:
    """Make the states of a pendulum again by mjx.step, compiled step by step."""
    jax, mjx = needed("jax"), needed("mujoco.mjx")
    told = _told(tmp_path, "--sim", "mjx", "--impl", "jax", "--scene", "pendulum", "--option", "device=cpu")
    model = mujoco.MjModel.from_xml_string(told.files["scene.xml"].decode())
    put, first = mjx.put_model(model), mjx.make_data(model)
    rows = [told.states["robot/qpos"][0, ..., 0]], [told.states["robot/qvel"][0, ..., 0]]
    data = jax.vmap(lambda qpos, qvel: first.replace(qpos=qpos, qvel=qvel))(rows[0][0], rows[1][0])
    step = jax.jit(lambda data: jax.vmap(lambda one: mjx.step(put, one))(data))
    for _ in range(_STEPS):
        data = step(data)
        rows[0].append(np.array(data.qpos))
        rows[1].append(np.array(data.qvel))
    _joint_states_equal(told, *rows)
