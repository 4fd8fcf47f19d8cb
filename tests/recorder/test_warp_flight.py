"""MuJoCo Warp looks at its states on the device: what it tells is what the default tells, which looks on the host."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.run import start
from gpusimbench.recorder.run.flight_phase import FlightPhase
from gpusimbench.recorder.run.journal import Journal
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.base import Description, Simulator
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas import topics
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.initial import Initial
from gpusimbench.schemas.treatment import Keep
from tests.recorder.engines import needed

needed("mujoco_warp")

pytestmark = pytest.mark.slow  # kernels are built


def _built(scene: str, n_env: int, **options: int) -> tuple[Simulator, Description]:
    adapter = find_simulator("warp").load()
    given = adapter.Options(device="cpu", **options)
    made: Simulator = adapter(make_scene(scene), n_env=n_env, dt=0.01, seed=3, options=given)
    return made, made.build()


@pytest.fixture(scope="module")
def falling() -> tuple[Simulator, Description]:
    """Cubes that fall on a board, in 3 worlds."""
    return _built("inclined-collision", 3)


@pytest.fixture(scope="module")
def crowded() -> tuple[Simulator, Description]:
    """The same in 18 worlds, with room for few constraints: the engine drops some."""
    return _built("inclined-collision", 18, njmax=40)


def _flown(built: tuple[Simulator, Description], path: Path, c: RunConfiguration, *, on_host: bool) -> dict[str, str]:
    """Digests of what the capture phase writes."""
    simulator, description = built
    simulator.reset()
    if c.initial:
        first = tuple(np.array(array) for array in simulator.state())
        drawn = Initial.parse(c.initial)
        simulator.set_state(start.drawn_states(drawn, simulator.scene, description.fields, first, c.seed))
    flight = type(simulator).flight
    sink = Sink(path, compression="none")
    try:
        sink.channel(topics.RUN_EVENT, "gsb.v1.Event")
        if on_host:
            simulator.flight = lambda watch: Simulator.flight(simulator, watch)  # type: ignore[method-assign]
        FlightPhase(Journal(sink), c, lambda *_: None).run(simulator, description)
        digests = sink.digest.digests()
    finally:
        simulator.__dict__.pop("flight", None)
        assert type(simulator).flight is flight
        sink.abandon()
        sink.partial.unlink()
    told = ("/flight/", topics.RUN_FAILING, topics.fingerprint("capture"))
    return {name: digest for name, digest in digests.items() if name.startswith(told)}


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    spread=st.floats(0.2, 3), seed=st.integers(0, 99), steps=st.integers(1, 150), poison=st.integers(0, 160),
    within=st.none() | st.floats(0.3, 2),
)  # fmt: skip
def test_as_the_default(
    falling: tuple[Simulator, Description],
    tmp_path: Path,
    spread: float,
    seed: int,
    steps: int,
    poison: int,
    within: float | None,
) -> None:
    """Keep the same states of the same environments, bit for bit, and say the same of them."""
    c = RunConfiguration(
        "warp", "inclined-collision", 3, 0.01, steps, seed=seed, initial=str(Initial(spread)),
        intervention=f"poison@{poison}" if poison < steps else "", keep=str(Keep(within)),
    )  # fmt: skip
    device = _flown(falling, tmp_path / "device.mcap", c, on_host=False)
    host = _flown(falling, tmp_path / "host.mcap", c, on_host=True)
    assert device == host
    assert topics.RUN_FAILING in device
    if poison < steps and within is None:
        assert [name for name in device if name.startswith("/flight/000001/")]


def test_overflow(crowded: tuple[Simulator, Description], tmp_path: Path) -> None:
    """Tell in which step a buffer first overflowed for each environment, as the default does."""
    c = RunConfiguration("warp", "inclined-collision", 18, 0.01, 60, keep="failing", initial="random:0.3")
    device = _flown(crowded, tmp_path / "device.mcap", c, on_host=False)
    assert device == _flown(crowded, tmp_path / "host.mcap", c, on_host=True)
    assert len({name.split("/")[2] for name in device if name.startswith("/flight/")}) == 16


def test_joints(tmp_path: Path) -> None:
    """Follow the same joint targets, and keep the same states of a robot's joints that are not finite."""
    c = RunConfiguration("warp", "franka", 2, 0.01, 30, seed=3, keep="failing", intervention="poison@12")
    arms = _built("franka", 2)
    device = _flown(arms, tmp_path / "device.mcap", c, on_host=False)
    assert device == _flown(arms, tmp_path / "host.mcap", c, on_host=True)
    assert {name for name in device if name.startswith("/flight/")} == {
        topics.flight(1, "robot", "qpos"), topics.flight(1, "robot", "qvel"),
    }  # fmt: skip
