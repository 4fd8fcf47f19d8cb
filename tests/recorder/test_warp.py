"""MuJoCo Warp in particular, on the CPU; what every simulator must do is in the conformance suite."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gpusimbench import open_recording
from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.run.vary import variation
from gpusimbench.recorder.scenes.franka import franka
from gpusimbench.recorder.scenes.inclined_collision import inclined_collision
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.recorder.simulators.warp.worlds import model_fields
from gpusimbench.schemas.action_generator import Streams
from gpusimbench.schemas.errors import GsbError, UsageError
from tests.conftest import Command
from tests.recorder import engines
from tests.recorder.engines import PAIR
from tests.scripts import ROOT, script

engines.needed("mujoco_warp")

build = partial(engines.build, "warp")


def test_equals_a_plain_loop() -> None:
    """Give the bits of mujoco_warp.step called by hand."""
    import mujoco
    import mujoco_warp as mjw

    simulator, description = build(PAIR)
    sizes = {buffer.name: buffer.asked for buffer in description.buffers}
    model = mujoco.MjModel.from_xml_string(description.attachments["scene.xml"][1].decode())
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    data = mjw.make_data(model, nworld=2, nconmax=sizes["nconmax"], njmax=sizes["njmax"])
    warped = mjw.put_model(model)
    for _ in range(20):
        mjw.step(warped, data)
    simulator.step(20)
    positions = simulator.state()[0]
    assert positions.tobytes() == np.ascontiguousarray(data.qpos.numpy().reshape(2, 2, 7)[..., :3]).tobytes()


@pytest.mark.slow
def test_a_contact_far_from_its_boxes(capsys: pytest.CaptureFixture[str]) -> None:
    """Say what the page on simulators says of the three collision functions; the bits of a CPU decide how often."""
    script("far_contact").main()
    lines = [line for line in capsys.readouterr().out.splitlines() if "contacts:" in line]
    page = (ROOT / "docs" / "simulators.md").read_text(encoding="utf-8")
    said, written = ([re.sub(r"\d+ of 511", "n of 511", line) for line in text] for text in (lines, page.splitlines()))
    assert len(said) == 3
    assert set(said) <= set(written)
    often = [int(line.partition(" m in ")[2].partition(" of ")[0]) for line in lines]
    assert [count > 0 for count in often] == [False, True, False]


@pytest.mark.parametrize("asked", [1e-8, 1e-4])
def test_the_tolerance_that_is_in_force(asked: float) -> None:
    """Say where MuJoCo Warp takes another tolerance than the model has, and only there."""
    simulator, description = build(PAIR, tolerance=asked)
    held = float(simulator._model.opt.tolerance.numpy()[0])
    said = [float(d.used) for d in description.deviations if d.parameter == "option.tolerance"]
    assert said == ([] if held == np.float32(asked) else pytest.approx([held]))
    assert bool(said) == (asked == 1e-8)


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 2**64 - 1),
    step=st.integers(0, 2**31 - 2),
    given_to=st.lists(st.tuples(st.integers(0, 9), st.integers(0, 2**31 - 1)), min_size=1, max_size=5),
)
def test_targets_are_drawn_on_the_device(seed: int, step: int, given_to: list[tuple[int, int]]) -> None:
    """Make on the device, bit for bit, the targets that the scene defines, also after the streams were exchanged."""
    import warp as wp

    from gpusimbench.recorder.simulators.warp.runtime import DeviceActions

    actions = franka().actions
    assert actions is not None
    env, begun = (np.array(column, dtype=np.uint32) for column in zip(*given_to, strict=True))
    n_env = len(given_to)
    with wp.ScopedDevice("cpu"):
        drawn = DeviceActions(actions, seed, Streams.usual(n_env))
        for streams in (Streams.usual(n_env), Streams(env, begun)):
            drawn.follow(streams)
            ctrl = wp.zeros((n_env, len(actions.joints)), dtype=float)
            drawn.step.fill_(step)
            drawn.enqueue(ctrl)
            expected = actions.draw(seed, n_env=n_env, first_step=step, n_step=1, streams=streams)[0]
            assert ctrl.numpy().tobytes() == expected.tobytes()
            assert drawn.step.numpy().tolist() == [step + 1]


def test_counts_of_a_resting_stack() -> None:
    """Count four contacts a face, three rows a contact, in every environment and at every step."""
    simulator, description = build(PAIR, n_env=3)
    simulator.states(10)  # bodies that merely touch, in float32, are in contact from the second step or so on
    evidence = simulator.evidence()
    assert set(evidence.counts) == {counter.name for counter in description.counters}
    assert (evidence.counts["contacts"][4:] == 8).all()
    assert (evidence.counts["constraint_rows"][4:] == 24).all()
    assert evidence.counts["contacts"].shape == (10, 3)
    assert not evidence.overflow.any()
    simulator.step(1)
    after = simulator.evidence()
    assert after.counts["contacts"].tolist() == [[8, 8, 8]]


@pytest.mark.parametrize(
    ("option", "bit"),
    [pytest.param({"nconmax": 4}, "NARROWPHASE", marks=pytest.mark.slow), ({"njmax": 12}, "NEFC")],
)
def test_a_small_buffer_makes_the_run_invalid(
    option: dict[str, int], bit: str, gsb_record: Command, tmp_path: Path
) -> None:
    """Say at which step which buffer dropped what, and end as invalid."""
    simulator, description = build(inclined_collision(), n_env=1, **option)
    simulator.states(3)
    evidence = simulator.evidence()
    assert evidence.overflow is not None
    names = {b.bit: b.name for b in description.overflow_bits if b.fatal}
    fired = {name for number, name in names.items() if (evidence.overflow[2] >> number & 1).any()}
    assert bit in fired
    given = [f"--option={name}={value}" for name, value in option.items()]
    gsb_record("--sim", "warp", "--n-env", 2, "--runs", 1, "--steps", 3, "--phases", "capture", *given,
                      "--out", tmp_path, code=1)  # fmt: skip
    recording = open_recording(next(tmp_path.glob("*.mcap")))
    assert recording.status == "invalid"
    assert bit in recording.reason
    assert "in 2 of 2 envs, first at step " in recording.reason


@pytest.mark.slow
def test_measured_buffers_hold_the_impact() -> None:
    """Drop nothing while the ball hits the stack, with buffers as measured."""
    simulator, description = build(inclined_collision())
    simulator.states(80)
    evidence = simulator.evidence()
    fatal = sum(1 << b.bit for b in description.overflow_bits if b.fatal)
    assert not (evidence.overflow & fatal).any()
    most = evidence.counts["contacts"].max()
    assert 109 <= most < next(b.asked for b in description.buffers if b.name == "nconmax")


def test_a_constraint_solver_that_warp_has_not() -> None:
    """Refuse MuJoCo's PGS as an outcome, with the option that replaces it."""
    with pytest.raises(Refused, match="mjSOL_PGS is unsupported; --option solver=Newton replaces the model's own"):
        build(PAIR, solver="PGS")


@pytest.mark.slow
def test_a_level_that_warp_cannot_compile_is_refused(gsb_record: Command, tmp_path: Path) -> None:
    """Record the engine's own reason where a determinism level cannot be had."""
    gsb_record("--sim", "warp", "--n-env", 1, "--runs", 1, "--phases", "capture", "--steps", 1,
                      "--determinism", "warp-run-to-run", "--out", tmp_path, code=1)  # fmt: skip
    recording = open_recording(next(tmp_path.glob("*.mcap")))
    assert recording.status == "failed"
    assert "MuJoCo Warp refuses determinism 'warp-run-to-run'" in recording.reason
    assert "Deterministic mode cannot compile this kernel" in recording.reason


def test_levels_are_in_force() -> None:
    """Record which of the engine's own switches a level has set."""
    _, description = build(PAIR, determinism="contacts-constraint")
    assert description.switches["opt.deterministic"] == "CONTACTS|CONSTRAINT"


def test_a_device_that_is_not_there() -> None:
    """Name the devices that can be asked for."""
    with pytest.raises(UsageError, match="device"):
        build(PAIR, device="cuda:7")


def test_parameters_of_worlds() -> None:
    """Have of each world what MuJoCo compiles of its scene, also what it derives from masses and sizes."""
    from gpusimbench.recorder.simulators.mujoco.model import compile_varied
    from gpusimbench.recorder.simulators.mujoco.options import MjcfOptions

    scene = inclined_collision()
    drawn = variation("mass:0.1,friction:0.2,size:0.05", scene, n_env=3, seed=1)
    assert drawn is not None
    adapter = find_simulator("warp").load()
    simulator = adapter(scene, n_env=3, dt=scene.dt, seed=1, options=adapter.Options(device="cpu"))
    simulator.vary(drawn)
    simulator.build()
    models = compile_varied(scene, drawn, n_env=3, dt=scene.dt, options=MjcfOptions())
    for name in (
        "body_mass", "body_inertia", "body_subtreemass", "body_invweight0", "dof_invweight0", "geom_friction",
        "geom_size", "geom_aabb", "geom_rbound",
    ):  # fmt: skip
        found = getattr(simulator._model, name).numpy()
        wanted = np.array([getattr(model, name) for model in models], dtype=np.float32)
        assert np.array_equal(found.reshape(wanted.shape), wanted), name
    simulator.close()


def test_a_field_that_worlds_share() -> None:
    """Refuse models that differ in what MuJoCo Warp has once for all worlds."""
    import mujoco

    text = '<mujoco><worldbody><body><joint range="0 1"/><geom size="1" condim="{}"/></body></worldbody></mujoco>'
    models = [mujoco.MjModel.from_xml_string(text.format(condim)) for condim in (3, 4)]
    with pytest.raises(GsbError, match="MuJoCo Warp has one 'geom_condim' for all worlds"):
        model_fields(models[0], models)
