"""Isaac Lab in particular: its start, its two backends, what they drop and what they refuse."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("isaaclab")
pytest.importorskip("ovphysx")

from gpusimbench.recorder.options import parse_options
from gpusimbench.recorder.scenes.base import Body, Box, Plane, Scene
from gpusimbench.recorder.scenes.cube_stack import ROUGH_WOOD, SMOOTH_WOOD
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.base import Description, States
from gpusimbench.recorder.simulators.isaaclab.options import IsaacLabOptions
from gpusimbench.recorder.simulators.isaaclab.physx import Physx
from gpusimbench.recorder.simulators.isaaclab.simulator import IsaacLab
from gpusimbench.schemas.errors import UsageError

N_ENV = 2

# Newton builds its kernels for a minute where they are not in Warp's cache yet
backends = pytest.mark.parametrize("backend", ["ovphysx", pytest.param("newton", marks=pytest.mark.slow)])
slow = pytest.mark.slow

# the engine's own, of its next release; mujoco's of numpy
pytestmark = pytest.mark.filterwarnings("ignore::FutureWarning", "ignore::DeprecationWarning", "ignore::UserWarning")


@contextmanager
def built(
    scene: str | Scene = "inclined-collision", *, n_env: int = N_ENV, determinism: str = "default", **options: str
) -> Iterator[tuple[IsaacLab, Description]]:
    """An adapter, built on the CPU; closed at the end."""
    simulator = IsaacLab(
        make_scene(scene) if isinstance(scene, str) else scene,
        n_env=n_env,
        dt=0.01,
        seed=0,
        options=parse_options("isaaclab", IsaacLabOptions, {"device": "cpu", **options}),
        determinism=determinism,
    )
    try:
        yield simulator, simulator.build()
    finally:
        simulator.close()


def same(one: States, other: States) -> bool:
    """Whether two states have the same bits."""
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def tower(count: int) -> Scene:
    """So many cubes in free fall, each with a speed of its own."""
    cubes = tuple(
        Body(
            f"cube {index}", Box((0.02, 0.02, 0.02)), SMOOTH_WOOD, position=(0.1 * index, 0.0, 1.0), mass=0.005,
            group="cubes", linear_velocity=(0.1 * index, 0.0, 0.0),
        )
        for index in range(count)
    )  # fmt: skip
    ground = Body("ground", Plane(), ROUGH_WOOD, position=(0.0, 0.0, 0.0))
    return replace(make_scene("free-fall"), name="tower", bodies=(ground, *cubes))


@backends
def test_second_simulation_repeats_the_first(backend: str) -> None:
    """A simulation that was closed leaves nothing behind: the next in the same process has the same bits."""
    trajectories = []
    for _ in range(2):
        with built(backend=backend) as (simulator, _):
            trajectories.append(simulator.states(5))
    assert same(*trajectories)


@backends
def test_states_that_are_set_belong_to_their_environments(backend: str) -> None:
    """Poses and speeds go to the environments that they are meant for, whatever the order, and the others stay."""
    with built(n_env=3, backend=backend) as (simulator, _):
        simulator.step(3)
        before = simulator.state()
        given = tuple(array[[2, 0]].copy() for array in simulator.state())
        given[2][:] = [[[0.5, 0.0, 0.0]], [[-0.5, 0.0, 0.0]]]
        simulator.set_state(given, np.array([2, 0]))
        after = simulator.state()
        assert same(tuple(array[[1]] for array in before), tuple(array[[1]] for array in after))
        for wanted, found in zip(given, after, strict=True):
            assert np.allclose(wanted, found[[2, 0]], atol=1e-6)


@slow
def test_another_simulation_goes_on_from_a_snapshot() -> None:
    """Newton's solver begins where the snapshot has it, also if the state is restored before kernels are built."""
    with built(backend="newton") as (simulator, _):
        simulator.step(60)  # the ball is among the cubes
        saved = simulator.snapshot()
        assert saved.arrays["qacc_warmstart"].any()
        wanted = simulator.states(5)
    with built(backend="newton") as (simulator, _):
        simulator.restore(saved)
        assert same(wanted, simulator.states(5))


@pytest.mark.parametrize("count", [1, 5, 6, 7, 8])
def test_bodies_keep_their_own_speeds(count: int) -> None:
    """Any number of bodies moves as described, also those numbers for which Isaac Lab mixes them up."""
    with built(tower(count), n_env=3) as (simulator, description):
        start = simulator.state()
        states = simulator.states(3)
        speed = next(i for i, layout in enumerate(description.fields) if layout.field == "linear_velocity")
        wanted = 0.1 * np.arange(count)
        assert np.allclose(states[speed][..., 0], wanted, atol=1e-6)
        assert np.allclose(states[0][-1, ..., 0] - start[0][..., 0], 0.03 * wanted, atol=1e-5)


def test_origins_are_a_grid_about_the_worlds() -> None:
    """States are in the world frame; the origins lie `spacing` apart, and are left out where there are none."""
    with built(n_env=4, spacing="3") as (simulator, description):
        origins = np.array(description.env_origins)
        assert sorted(map(tuple, origins)) == [(x, y, 0.0) for x in (-1.5, 1.5) for y in (-1.5, 1.5)]
        ball = simulator.state()[0][:, 0]
        assert np.allclose(ball - origins, make_scene("inclined-collision").moving()[0].position, atol=1e-6)
    with built(spacing="0") as (_, description):
        assert description.env_origins == ()


@backends
def test_cubes_land_on_a_plane(backend: str) -> None:
    """A plane is one for all environments, and carries them at any distance from its origin."""
    with built(tower(2), spacing="20", backend=backend) as (simulator, _):
        simulator.step(150)
        assert np.allclose(simulator.state()[0][..., 2], 0.01, atol=1e-3)


@slow
def test_newton_at_one_place_repeats_itself() -> None:
    """Environments without offsets have the same bits; with offsets they round differently."""
    for spacing, alike in (("0", True), ("4", False)):
        with built(backend="newton", spacing=spacing) as (simulator, _):
            states = simulator.states(5)
            assert all(np.array_equal(array[:, 0], array[:, 1]) for array in states) is alike


@slow
@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
def test_a_stack_whose_cubes_hardly_slip(cone: str) -> None:
    """MuJoCo Warp 3.12 factorises an indefinite matrix where contacts of elliptic cones slip slowly: the states are not
    finite within 10 steps, and the recording names the fault in advance. Pyramidal cones stay finite."""
    import mujoco_warp

    faulty = cone == "elliptic" and mujoco_warp.__version__.startswith("3.")
    with built("free-fall", n_env=16, backend="newton", spacing="0", cone=cone) as (simulator, description):
        assert any("not finite" in remark for remark in description.remarks) is faulty
        drawn = np.random.default_rng(5)
        simulator.set_state(
            tuple(
                array + drawn.normal(scale=1e-5, size=array.shape).astype(np.float32)  # m/s
                if layout.field == "linear_velocity" else array
                for layout, array in zip(description.fields, simulator.state(), strict=True)
            )
        )  # fmt: skip
        states = simulator.states(10)
        assert all(np.isfinite(array).all() for array in states) is not faulty


@slow
def test_newton_tells_of_rows_that_do_not_fit() -> None:
    """Too few rows set a fatal bit, in evidence of states and of steps alike."""
    with built(backend="newton", max_rows="64") as (simulator, description):
        fatal = sum(1 << bit.bit for bit in description.overflow_bits if bit.fatal)
        simulator.states(5)
        captured = simulator.evidence()
        simulator.step(5)
        stepped = simulator.evidence()
        for evidence in (captured, stepped):
            assert evidence is not None and evidence.overflow is not None
            assert (evidence.overflow[-1] & fatal).all()
        rows = next(buffer for buffer in description.buffers if buffer.name == "njmax")
        assert rows.asked > 64  # Newton gives as many as the first state needs
        assert rows.sized_by == "64 wanted (asked for), which Newton has changed"


def test_physx_tells_of_what_it_drops(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """A line of PhysX about an overflow, or an error of it, is a gate; what else it prints is none."""
    with built() as (simulator, _):
        assert simulator.gates() == []
        with open(1, "w", closefd=False) as stdout:  # as native code prints, past pytest
            stdout.write("Patch buffer overflow detected, please increase its size to at least 7 in the scene desc!\n")
            stdout.write("[Warning] [omni.physx] something else\n")
        (gate,) = simulator.gates()
        assert "Patch buffer overflow" in gate
        assert simulator.gates() == []


def test_buffers_of_a_gpu_are_measured() -> None:
    """Isaac Lab's own sizes are kept while they are enough; more environments, or a user, get others."""
    scene, options = make_scene("inclined-collision"), IsaacLabOptions(gpu_collision_stack_size=1 << 20)

    def sizes(n_env: int) -> dict[str, Any]:
        physics = Physx(scene, n_env=n_env, dt=0.01, seed=0, options=options, level="default", gpu=True)
        physics.close()
        assert physics.in_force()["gpu_max_rigid_contact_count"] == 0  # nobody asked for a size
        assert physics.in_force()["gpu_collision_stack_size"] == 1 << 20
        assert physics.cfg.gpu_collision_stack_size == 1 << 20
        return {buffer.name: buffer for buffer in physics.buffers}

    few, many = sizes(2), sizes(1 << 16)
    assert few["gpu_max_rigid_contact_count"].asked == 2**23
    assert many["gpu_max_rigid_contact_count"].asked > 2**23
    assert many["gpu_collision_stack_size"].sized_by == "asked for"
    assert all(buffer.sized_by for buffer in many.values())


@pytest.mark.parametrize(
    ("backend", "determinism", "words"),
    [
        ("ovphysx", "run-to-run", "has no determinism 'run-to-run'"),
        ("newton", "enhanced", "has no determinism 'enhanced'"),
        ("physx", "default", "needs Isaac Sim"),
    ],
)
def test_says_what_a_backend_does_not_have(backend: str, determinism: str, words: str) -> None:
    """A level of another backend, and a backend that is not installed, are refused in a sentence."""
    with pytest.raises(UsageError, match=words), built(backend=backend, determinism=determinism):
        pass


def test_enhanced_determinism_is_given_to_the_engine() -> None:
    """The level becomes an attribute of the stage, and a switch."""
    with built(determinism="enhanced") as (_, description):
        assert description.switches["enhanced_determinism"] is True
        stage = description.attachments["scene.usda"][1].decode()
        assert "bool physxScene:enableEnhancedDeterminism = 1" in stage
        assert "env_0" in stage and "env_1" not in stage
        # materials of an environment would be too many for PhysX, times thousands of environments
        assert stage.count("def Material") == len(
            {body.material.name for body in make_scene("inclined-collision").bodies}
        )


@pytest.mark.parametrize(
    ("name", "value"),
    [("backend", "bullet"), ("spacing", "-1"), ("contact_offset", "0"), ("friction_combine", "mean"),
     ("position_iterations", "256"), ("iterations", "0"), ("gpu_collision_stack_size", "-1")],
)  # fmt: skip
def test_rejects_values_that_mean_nothing(name: str, value: str) -> None:
    """An impossible value of an option is named."""
    with pytest.raises(UsageError, match=name):
        parse_options("isaaclab", IsaacLabOptions, {name: value})


def test_leaves_no_file_in_the_working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is put where the run works becomes an attachment: nothing is."""
    monkeypatch.chdir(tmp_path)
    with built() as (simulator, _):
        simulator.step(1)
    assert list(tmp_path.iterdir()) == []
