"""ManiSkill in particular: its own settings, its refusals, and that SAPIEN is what steps it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mani_skill")

from gpusimbench.recorder.conformance import CHECKS, Subject
from gpusimbench.recorder.conformance import subject as conformance_subject
from gpusimbench.recorder.conformance.scene import MARBLE, STONE, conformance_scene
from gpusimbench.recorder.conformance.verdict import NotApplicable
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.base import Description, Simulator, States
from gpusimbench.recorder.simulators.maniskill.simulator import ManiSkill, ManiSkillOptions
from gpusimbench.recorder.simulators.sapien.complaints import Complaints
from gpusimbench.recorder.simulators.sapien.gpu import GpuWorlds
from gpusimbench.recorder.simulators.sapien.options import SapienOptions
from gpusimbench.recorder.simulators.sapien.simulator import Sapien
from gpusimbench.recorder.simulators.sapien.sizes import DEFAULTS, choose_sizes
from gpusimbench.recorder.simulators.snapshot import Extent
from gpusimbench.schemas.errors import UsageError

IMPACT = 80  # steps after which the ball has met the cubes of inclined-collision

DAMPED = {"turns_counter_clockwise", "angular_velocity_is_in_the_world_frame"}
"""Checks that ManiSkill as it ships fails: bodies are damped as they turn."""


def made(scene: Scene, *, n_env: int = 1, dt: float = 0.01, **options: Any) -> ManiSkill:
    """A simulator that is not built yet."""
    return ManiSkill(scene, n_env=n_env, dt=dt, seed=0, options=ManiSkillOptions(**options))


@contextmanager
def built(simulator: Simulator) -> Iterator[Description]:
    """A build that is closed at the end."""
    try:
        yield simulator.build()
    finally:
        simulator.close()


def same(one: States, other: States) -> bool:
    """Whether two states have the same bits."""
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def test_its_defaults_are_maniskills() -> None:
    """The options of physics have the values of ManiSkill's own configuration."""
    from mani_skill.utils.structs.types import SceneConfig, SimConfig

    own, shipped = ManiSkillOptions(), SceneConfig()
    shared = {field.name for field in fields(SceneConfig)} & {field.name for field in fields(ManiSkillOptions)}
    assert {"bounce_threshold", "contact_offset", "solver_position_iterations", "sleep_threshold"} < shared
    assert {name: getattr(own, name) for name in shared} == {name: getattr(shipped, name) for name in shared}
    assert own.spacing == SimConfig().spacing


def test_what_it_leaves_to_physx_is_as_told() -> None:
    """Damping and limit of a body are those that ManiSkill's own builder leaves."""
    from sapien import physx

    fresh, own = physx.PhysxRigidDynamicComponent(), ManiSkillOptions()
    assert fresh.angular_damping == pytest.approx(own.angular_damping)
    assert fresh.max_angular_velocity == pytest.approx(own.max_angular_velocity)
    assert fresh.linear_damping == 0.0


def test_more_than_one_environment_on_the_cpu_is_refused() -> None:
    """The error gives ManiSkill's own words."""
    with pytest.raises(UsageError, match="one environment on the CPU, not 2; it says: Cannot set the sim backend"):
        made(make_scene("free-fall"), n_env=2, device="cpu").build()


def test_more_environments_need_the_library_for_gpus(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """By default they go to a GPU, as ManiSkill chooses; nothing is fetched for it."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr("requests.get", lambda *_, **__: pytest.fail("something is downloaded"))
    simulator = made(make_scene("free-fall"), n_env=2)
    with pytest.raises(UsageError, match=r"on the CPU \(--n-env 1\), and 2 on a GPU;.*libPhysXGpu_64\.so, which is"):
        simulator.build()
    simulator.close()
    assert not (tmp_path / ".sapien").exists()


def test_the_environment_is_saved_reset_and_set() -> None:
    """Show the states that are brought back or given, where the CPU was asked for; else say that it has to be."""
    simulator = made(make_scene("inclined-collision"), device="cpu")
    assert ManiSkill.state_claims(simulator.options).reset.extent is Extent.PARTIAL
    assert "--option device=cpu" in ManiSkill.state_claims(ManiSkillOptions()).reset.why
    with built(simulator):
        first = simulator.state()
        simulator.step(IMPACT)
        saved, snapshot = simulator.state(), simulator.snapshot()
        simulator.step(5)
        assert not same(simulator.state(), saved)
        simulator.restore(snapshot)
        assert same(simulator.state(), saved)
        simulator.reset()
        assert same(simulator.state(), first)
        simulator.set_state(saved)
        assert same(simulator.state(), saved)


def test_steps_that_are_no_frequency_are_refused() -> None:
    """ManiSkill's frequencies are whole numbers."""
    with pytest.raises(UsageError, match="whole number of steps a second; dt is 0.003"):
        made(make_scene("free-fall"), dt=0.003).build()


def test_it_is_sapien_with_other_settings() -> None:
    """SAPIEN with ManiSkill's settings makes the same bits."""
    scene, own = make_scene("inclined-collision"), ManiSkillOptions()
    settings = {field.name: getattr(own, field.name) for field in fields(SapienOptions) if field.name != "device"}
    simulators = (
        made(scene),
        Sapien(scene, n_env=1, dt=0.01, seed=0, options=SapienOptions(**settings)),
    )
    runs: list[States] = []
    for simulator in simulators:
        with built(simulator):
            runs.append(simulator.states(IMPACT))
    assert all(a.tobytes() == b.tobytes() for a, b in zip(*runs, strict=True))


def test_the_environment_keeps_its_time() -> None:
    """A step of the simulator is one control step and one step of physics, of dt."""
    simulator = made(make_scene("free-fall"), dt=0.005)
    with built(simulator) as description:
        simulator.step(40)
        height = simulator.state()[0][0, 0, 2]
        assert description.switches["sim_freq"] == description.switches["control_freq"] == 200
    fallen = 9.81 * 0.005**2 * 40 * 41 / 2  # of a first-order integrator
    assert height == pytest.approx(0.51 - fallen, abs=1e-5)


@pytest.fixture(scope="module")
def alone() -> Iterator[Subject]:
    """The conformance suite's subject, with one environment wherever the suite would have more."""

    class Alone(Subject):
        @contextmanager
        def built(self, scene: Scene, *, n_env: int = 1) -> Iterator[tuple[Simulator, Description]]:
            with super().built(scene, n_env=1) as both:
                yield both

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(conformance_subject, "N_ENV", 1)
        patch.setattr("gpusimbench.recorder.conformance.checks.state._ENVS", 1)
        yield Alone.named("maniskill")


@pytest.mark.parametrize(
    "check",
    [
        check for check in CHECKS if check.__module__ != "gpusimbench.recorder.conformance.checks.recorded"
    ],  # runs of two
    ids=lambda check: check.__name__,
)
def test_one_environment_conforms(alone: Subject, check: Any) -> None:
    """All checks hold but those that find ManiSkill's damping."""
    try:
        check(alone)
    except NotApplicable as reason:
        pytest.skip(str(reason))
    except AssertionError:
        assert check.__name__ in DAMPED
    else:
        assert check.__name__ not in DAMPED


def test_what_turns_is_damped_by_what_is_told() -> None:
    """The stone and the marble lose angular_damping dt of their spin in each step, and none where it is 0."""
    scene = conformance_scene()
    for damping in (0.05, 0.0):
        simulator = made(scene, angular_damping=damping)
        with built(simulator) as description:
            told = "bodies.angular_damping" in {deviation.parameter for deviation in description.deviations}
            states = simulator.states(50)
            layout = next(f for f in description.fields if f.name == "flying/angular_velocity")
            speeds = states[description.fields.index(layout)][-1, 0]
        for name in (STONE, MARBLE):
            body = next(body for body in scene.moving() if body.name == name)
            expected = np.array(body.angular_velocity) * (1 - damping * 0.01) ** 50
            assert np.allclose(speeds[layout.items.index(name)], expected, atol=1e-4)
        assert told == (damping > 0)


def test_capacities_are_those_that_maniskill_documents() -> None:
    """Each field of ManiSkill's GPUMemoryConfig gets a capacity, never below its own, and SAPIEN takes them all."""
    from mani_skill.utils.structs.types import GPUMemoryConfig
    from sapien import physx

    shipped = GPUMemoryConfig()
    chosen = choose_sizes(
        make_scene("inclined-collision"), n_env=4096, dt=0.01, options=ManiSkillOptions(), defaults=shipped.dict()
    )
    capacities = {buffer.name: buffer.asked for buffer in chosen}
    assert set(capacities) == {field.name for field in fields(GPUMemoryConfig)}
    assert all(capacities[name] >= own for name, own in shipped.dict().items())
    assert capacities["max_rigid_contact_count"] > shipped.max_rigid_contact_count
    try:
        physx.set_gpu_memory_config(**GPUMemoryConfig(**capacities).dict())
    finally:
        physx.set_gpu_memory_config(**DEFAULTS)


class FakeSystem:
    """Stands for a PhysxGpuSystem: bodies move by their velocities, in torch's memory on the CPU."""

    def __init__(self, places: int) -> None:
        import torch

        self._truth = torch.zeros((places, 13))
        self._shown = torch.full((places, 13), float("nan"))
        self.cuda_rigid_body_data = SimpleNamespace(torch=lambda: self._shown)

    def gpu_apply_rigid_dynamic_data(self) -> None:
        self._truth.copy_(self._shown)

    def gpu_fetch_rigid_dynamic_data(self) -> None:
        self._shown.copy_(self._truth)

    def step(self) -> None:
        self._truth[:, :3] += 0.01 * self._truth[:, 7:10]
        if self._truth[0, 0] > 0.045:
            os.write(2, b"[SAPIEN] [critical] Contacts have been dropped\n")


def test_worlds_on_a_gpu_read_rows_by_their_places(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a stand-in for the engine: states, blocks larger than the ring, and lines that become bits at their step."""
    import torch

    monkeypatch.setattr(torch.cuda, "synchronize", lambda: None)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "stand-in")
    monkeypatch.setattr("gpusimbench.recorder.simulators.sapien.gpu._RING_ROWS", 3)
    template = make_scene("inclined-collision")
    ball = next(body for body in template.bodies if body.name == "ball")
    cube = template.moving()[1]
    scene = replace(
        template,
        bodies=(
            replace(ball, position=(0.0, 0.0, 0.0), linear_velocity=(1.0, 0.0, 0.0)),
            replace(cube, linear_velocity=(0.0, 2.0, 0.0), angular_velocity=(0.1, 0.2, 0.3)),
        ),
    )
    system = FakeSystem(4)
    bodies = [[SimpleNamespace(gpu_pose_index=place) for place in env] for env in ((3, 1), (0, 2))]
    complaints = Complaints()
    try:
        worlds = GpuWorlds(
            scene, system, bodies, origins=((0.0, 0.0, 0.0), (5.0, 0.0, 0.0)), buffers=(), complaints=complaints,
            step=system.step, timing_covers="a stand-in",
        )  # fmt: skip
        worlds.begin()
        first = worlds.state()
        states = worlds.record(7)
        masks = worlds.evidence().overflow
        worlds.advance(2)
        after = worlds.evidence().overflow
    finally:
        complaints.close()
    assert [(field.name, field.frame) for field in worlds.fields if field.field == "position"] == [
        ("ball/position", "env"),
        ("cubes/position", "env"),
    ]
    for layout, start_of, rows in zip(worlds.fields, first, states, strict=True):
        (body,) = (body for body in scene.bodies if body.name in layout.items)
        expected = np.array(getattr(body, layout.field), dtype=np.float32)
        assert np.array_equal(start_of, np.broadcast_to(expected, start_of.shape))
        assert rows.shape == (7, 2, 1, layout.width)
    assert np.allclose(states[0][:, :, 0, 0], 0.01 * np.arange(1, 8)[:, None])
    assert masks is not None
    assert (masks != 0).tolist() == [[step >= 5] * 2 for step in range(1, 8)]
    assert after.shape == (1, 2)
    assert (after == masks[-1]).all()
