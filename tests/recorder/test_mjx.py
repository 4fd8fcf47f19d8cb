"""MJX and MuJoCo Playground in particular, on the CPU; what every simulator must do is in the conformance suite.

Scenes are as small as the question allows: XLA compiles for seconds for each.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gpusimbench.recorder.environments.interpreter import own
from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.run.vary import refusal, variation
from gpusimbench.recorder.scenes.franka import franka
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas.action_generator import Streams
from gpusimbench.schemas.errors import UsageError
from tests.conftest import run_python
from tests.recorder.engines import PAIR, bits, build, counts, cubes, make, needed

needed("jax")
needed("mujoco.mjx")

LEVELS = {
    "default": "",
    "no-autotune": "--xla_gpu_autotune_level=0",
    "exclude-nondeterministic": "--xla_gpu_exclude_nondeterministic_ops=true",
    "run-to-run": "--xla_gpu_deterministic_ops=true --xla_gpu_autotune_level=0",
}


def test_precision_of_products_is_the_variables(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A run's process is given the user's variable; its switches, which group runs, say what JAX made of it."""
    monkeypatch.setenv("JAX_DEFAULT_MATMUL_PRECISION", "highest")
    script = "from gpusimbench.recorder.simulators.jax.runtime import switches; print(switches('default'))"
    done = run_python(script, code=None, env=own().environment(tmp_path))
    assert (done.returncode, "'matmul_precision': 'highest'" in done.stdout) == (0, True), done.stderr


@pytest.mark.parametrize(("level", "flags"), LEVELS.items())
def test_flags_of_a_level_are_xlas(level: str, flags: str) -> None:
    """Ask for flags that XLA knows: it ends a process that has any other."""
    adapter = find_simulator("mjx").load()
    wanted = adapter.environment(adapter.Options(), level)
    assert wanted.pop("XLA_PYTHON_CLIENT_PREALLOCATE") == "false"
    assert wanted.get("XLA_FLAGS", "") == flags
    assert set(adapter.determinism_levels) == set(LEVELS)
    script = "import jax; print(int(jax.jit(lambda x: x + 1)(1)))"
    done = run_python(script, code=None, env={**os.environ, **wanted})
    assert (done.returncode, done.stdout) == (0, "2\n"), done.stderr


def test_the_cpu_is_asked_for_before_jax_looks_for_others() -> None:
    """Keep JAX from touching a GPU that nothing will run on."""
    adapter = find_simulator("mjx").load()
    assert adapter.environment(adapter.Options(device="cpu"), "default")["JAX_PLATFORMS"] == "cpu"
    assert "JAX_PLATFORMS" not in adapter.environment(adapter.Options(), "default")


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 2**64 - 1),
    step=st.integers(0, 2**31 - 2),
    given_to=st.lists(st.tuples(st.integers(0, 9), st.integers(0, 2**31 - 1)), min_size=1, max_size=3),
)
def test_targets_are_drawn_on_the_device(seed: int, step: int, given_to: list[tuple[int, int]]) -> None:
    """Make on the device, bit for bit, the targets that the scene defines, whatever streams environments follow."""
    from gpusimbench.recorder.simulators.jax.simulator import device_draw

    actions = franka().actions
    assert actions is not None
    env, begun = (np.array(column, dtype=np.uint32) for column in zip(*given_to, strict=True))
    drawn = np.asarray(device_draw(actions, seed=seed)(np.uint32(step), env, begun))
    expected = actions.draw(seed, n_env=len(env), first_step=step, n_step=1, streams=Streams(env, begun))
    assert drawn.tobytes() == expected[0].tobytes()


@pytest.mark.slow
def test_a_restored_state_is_stepped_by_the_program_of_the_first() -> None:
    """Give XLA the same program, so that no run that begins with a snapshot compiles what JAX's cache has."""
    simulator, _ = build("mjx", PAIR)
    first = simulator._lowered("advance").as_text()
    simulator.restore(simulator.snapshot())
    assert simulator._lowered("advance").as_text() == first


@pytest.mark.parametrize("options", [{"impl": "vulkan"}, {"cone": "round"}, {"njmax": -1}, {"device": "tpu"}])
def test_options_that_there_are_not(options: dict[str, Any]) -> None:
    """Refuse values that MJX has no meaning for."""
    with pytest.raises(UsageError, match=next(iter(options))):
        make("mjx", PAIR, **options)


@pytest.mark.parametrize(
    ("options", "instead"),
    [
        ({"integrator": "implicit"}, "integrator=implicitfast"),
        ({"integrator": "discrete"}, "integrator=implicitfast"),
        ({"solver": "PGS"}, "solver=Newton"),
    ],
)
def test_what_mjx_has_not_implemented_is_refused(options: dict[str, Any], instead: str) -> None:
    """Say as an outcome, not as a crash, that the implementation in JAX lacks something, and what to give instead."""
    simulator = make("mjx", PAIR, n_env=1, **options)
    with pytest.raises(Refused, match=f"impl=jax.*; --option {instead} replaces"):
        simulator.build()
        simulator.compile("timed")


class TestJax:
    """impl=jax: contacts are limited, and what the limits may have cost is counted."""

    def test_the_cone_is_the_one_that_is_stable(self) -> None:
        """Choose the cone by the implementation, unless it is given."""
        adapter = find_simulator("mjx").load()
        assert adapter.Options().physics("jax").cone == "pyramidal"
        assert adapter.Options().physics("warp").cone == "elliptic"
        assert adapter.Options(cone="elliptic").physics("jax").cone == "elliptic"

    @pytest.mark.slow
    def test_by_step_and_by_states(self) -> None:
        """Reach the same bits by step, by states, in pieces of any size; and count four contacts a face, four rows of a
        pyramid a contact, three pairs of boxes that could touch."""
        simulator, description = build("mjx", PAIR, ring=3)
        assert {b.name: b.asked for b in description.buffers} == {"max_geom_pairs": 32, "max_contact_points": 32}
        assert all("MuJoCo C" in buffer.sized_by for buffer in description.buffers)
        simulator.step(4)
        simulator.step(7)
        by_steps = simulator.state()
        expected = {"contacts": 8, "constraint_rows": 32, "candidate_pairs": 3}
        for name, count in expected.items():
            assert counts(simulator, name) == [[count, count]]
        assert bits(simulator) == 0
        other, _ = build("mjx", PAIR, ring=3)
        other.states(4)
        captured = other.states(7)
        for name, count in expected.items():
            assert counts(other, name)[3:] == [[count, count]] * 4
        assert bits(other) == 0
        assert captured[0].shape == (7, 2, 2, 3)
        assert [a.tobytes() for a in by_steps] == [a[-1].tobytes() for a in captured]

    @pytest.mark.slow
    def test_limits_that_may_have_dropped_something(self) -> None:
        """Set the bits of the limits that were reached."""
        limits = {"max_geom_pairs": 2, "max_contact_points": 4}
        simulator, description = build("mjx", PAIR, n_env=1, **limits)
        assert {b.name: b.asked for b in description.buffers if b.sized_by == "asked for"} == limits
        simulator.step(5)
        assert bits(simulator) == 0b11

    @pytest.mark.slow
    def test_bits_of_earlier_steps_are_kept(self) -> None:
        """Tell of contacts that were dropped in the timed phase's first steps, though the last has none; tell once."""
        cube = next(body for body in PAIR.bodies if body.name == "cube_0_0_0")
        leaving = replace(cube, position=(0.06, -0.02, 0.0299), linear_velocity=(0.0, 0.0, 3.0))
        scene = replace(PAIR, bodies=(PAIR.bodies[0], leaving))
        simulator, _ = build("mjx", scene, n_env=1, max_contact_points=2)
        simulator.step(20)
        evidence = simulator.evidence()
        assert evidence.counts["contacts"].tolist() == [[0]]
        assert evidence.overflow.tolist() == [[0b10]]
        simulator.step(5)
        assert bits(simulator) == 0

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("pairs", "points", "contacts", "bit"), [(2, 100, 4, 0b01), (100, 8, 8, 0b10), (3, 9, 8, 0)]
    )
    def test_which_limit_was_reached(self, pairs: int, points: int, contacts: int, bit: int) -> None:
        """Tell which limit was too small for two cubes a hair within each other and the board."""
        import jax
        from mujoco import mjx

        from gpusimbench.recorder.simulators.mjx import physics as mjx_physics

        options = find_simulator("mjx").load().Options(max_geom_pairs=pairs, max_contact_points=points)
        model = mjx_physics.load(PAIR, n_env=1, dt=0.01, seed=0, options=options, impl="jax")
        device = jax.devices("cpu")[0]
        compiled = model.compiled
        start = (jax.numpy.asarray(numbers, "float32") for numbers in (compiled.qpos0, compiled.qvel0))
        on_device, data = model.put(device), model.first_data(device, *start)
        data = data.replace(qpos=data.qpos.at[2].add(-1e-4).at[9].add(-2e-4))
        data = jax.vmap(lambda _: data)(np.arange(1))
        data = jax.jit(jax.vmap(mjx.fwd_position, (None, 0)))(on_device, data)
        count = jax.jit(model.count)
        counted = count(data)
        assert counted["overflow"].tolist() == [bit]
        assert counted["contacts"].tolist() == [contacts]
        assert counted["constraint_rows"].tolist() == [4 * contacts]
        assert counted["candidate_pairs"].tolist() == [3]
        assert counted["misplaced_contacts"].tolist() == [0]
        away = data.tree_replace({"_impl.contact.pos": data._impl.contact.pos + 1.0})
        assert count(away)["misplaced_contacts"].tolist() == [contacts]

    def test_limits_that_mjx_reads_otherwise_are_refused(self) -> None:
        """Refuse a model whose limits stand behind an array of numbers, where MJX takes the array's for them."""
        import mujoco

        from gpusimbench.recorder.simulators.mjx.caps import Caps, check_read

        numbers = '<numeric name="start" data="0 0 0"/><numeric name="max_geom_pairs" data="7"/>'
        model = mujoco.MjModel.from_xml_string(f"<mujoco><custom>{numbers}</custom></mujoco>")
        with pytest.raises(Refused, match="max_geom_pairs = 0 from the model, which says 7"):
            check_read(model, Caps(7, 7, ()))

    def test_shapes_without_collisions_are_refused(self) -> None:
        """Name the two kinds of shapes of a model between which MJX computes no contacts."""
        import mujoco

        from gpusimbench.recorder.simulators.mjx.caps import pair_groups
        from gpusimbench.recorder.simulators.mjx.physics import refusals

        body = '<body><freejoint/><geom type="{}" size=".1 .1 .1"/></body>'
        bodies = "".join(body.format(kind) for kind in ("box", "cylinder"))
        model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
        with pytest.raises(Refused, match="no collisions between cylinder and box"), refusals("jax"):
            pair_groups(model)

    def test_a_dropped_pair_is_one_of_the_candidates(self) -> None:
        """Count overlapping bounding spheres as MJX orders pairs by them."""
        import jax.numpy as jnp
        import mujoco

        from gpusimbench.recorder.simulators.mjx.caps import Certificate, choose
        from gpusimbench.recorder.simulators.mujoco.model import compile_scene

        options = find_simulator("mjx").load().Options().physics("jax")
        scene = cubes("cube_0_0_0", "cube_1_0_0", "cube_2_0_0")
        compiled = compile_scene(scene, dt=0.01, options=options)
        caps = choose(compiled, dt=0.01, seed=0, max_geom_pairs=1, max_contact_points=1)
        certificate = Certificate(compiled.model, caps)
        data = compiled.data()
        radius = compiled.model.geom("cube_0_0_0").rbound[0]
        neighbours = compiled.model.geom("cube_1_0_0").id, compiled.model.geom("cube_2_0_0").id
        board = compiled.model.geom("board").id
        assert data.geom_xpos[board].shape == (3,)
        for apart, overlapping in ((1.99 * radius, True), (2.01 * radius, False)):
            centres = data.geom_xpos.copy()
            centres[neighbours[0]] = (100.0, 0.0, 0.0)
            centres[neighbours[1]] = (100.0 + apart, 0.0, 0.0)
            centres[compiled.model.geom("cube_0_0_0").id] = (-100.0, 0.0, 0.0)
            found = certificate.candidates(jnp.asarray(centres, jnp.float32)[None])
            assert found.tolist() == [int(overlapping)]
        assert mujoco.mjtGeom.mjGEOM_BOX in compiled.model.geom_type


class TestWarp:
    """impl=warp: buffers overflow with a bit, in kernels that are built when they first run."""

    @pytest.mark.slow
    @pytest.mark.parametrize(("option", "bit"), [({"naconmax": 4}, "NARROWPHASE"), ({"njmax": 12}, "NEFC")])
    def test_a_buffer_that_is_too_small(self, option: dict[str, int], bit: str) -> None:
        """Set the engine's bit at some step of many, keep it until it is asked for, forget it then."""
        simulator, description = build("mjx", PAIR, n_env=1, impl="warp", **option)
        numbers = {b.name: b.bit for b in description.overflow_bits if b.fatal}
        assert "ITERATIONS" not in numbers
        simulator.step(5)
        assert bits(simulator) & 1 << numbers[bit]
        assert bits(simulator) == 0
        simulator.states(2)
        assert bits(simulator) & 1 << numbers[bit]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "options"), [("mjx", {"impl": "warp"}), ("playground", {})])
def test_actions_are_the_scenes(name: str, options: dict[str, str]) -> None:
    """Hold at each step the targets of that step, counted over calls of any kind."""
    scene = franka()
    simulator, _ = build(name, scene, seed=7, **options)
    expected = scene.actions.draw(7, n_env=2, first_step=0, n_step=9)
    done = 0
    for count, advance in ((3, simulator.step), (4, simulator.states), (2, simulator.step)):
        advance(count)
        done += count
        applied = simulator.applied()
        assert applied.tobytes() == expected[done - 1].tobytes()


@pytest.mark.slow
def test_playground_steps_its_own_way_to_the_same_bits() -> None:
    """Take the package's default implementation, and lead where MJX leads with it."""
    environment, description = build("playground", PAIR)
    assert description.options["impl"] == "warp"
    plain, _ = build("mjx", PAIR, impl="warp")
    for simulator in (environment, plain):
        simulator.step(9)
    pairs = zip(environment.state(), plain.state(), strict=True)
    assert all(a.tobytes() == b.tobytes() for a, b in pairs)
    assert counts(environment, "contacts") == [[8, 8]]


@pytest.mark.parametrize(
    ("scene", "vary"), [("inclined-collision", "mass:0.1,friction:0.2,size:0.05"), ("franka", "mass:0.1,friction:0.2")]
)
def test_parameters_of_an_environment_are_those_of_its_own_model(scene: str, vary: str) -> None:
    """Have in an environment's row of the batched model what MJX makes of the model of that environment alone."""
    import jax
    from mujoco import mjx

    from gpusimbench.recorder.simulators.mjx.physics import batched, model_fields
    from gpusimbench.recorder.simulators.mujoco.model import compile_scene, compile_varied
    from gpusimbench.recorder.simulators.mujoco.options import MjcfOptions

    made, options = make_scene(scene), MjcfOptions(cone="pyramidal")
    drawn = variation(vary, made, n_env=3, seed=0)
    assert drawn is not None
    common = compile_scene(made, dt=made.dt, options=options).model
    models = compile_varied(made, drawn, n_env=3, dt=made.dt, options=options)
    varied = model_fields(common, models)
    assert {"body_mass", "body_inertia", "dof_invweight0", "geom_friction", "stat.meaninertia"} <= varied.keys()
    whole, axes = batched(mjx.put_model(common), varied)
    assert {axis for axis in jax.tree.leaves(axes, is_leaf=lambda x: x is None) if axis is not None} == {0}
    taken = [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(axes)]
    assert sorted(taken) == sorted(f".{name}" for name in varied)
    for env in (0, 2):
        alone = dict(jax.tree_util.tree_leaves_with_path(mjx.put_model(models[env])))
        for path, leaf in jax.tree_util.tree_leaves_with_path(whole):
            own = leaf[env] if jax.tree_util.keystr(path) in taken else leaf
            assert np.array_equal(np.asarray(own), np.asarray(alone[path])), jax.tree_util.keystr(path)


def test_parameters_vary_with_jax_alone() -> None:
    """Name the implementation that can vary parameters, where another was asked for."""
    adapter = find_simulator("mjx").adapter()
    scene = make_scene("inclined-collision")
    assert not refusal("mjx", adapter, adapter.Options(), scene, "mass:0.1")
    said = refusal("mjx", adapter, adapter.Options(impl="warp"), scene, "mass:0.1,size:0.1")
    assert said.endswith("it has no masses per environment or sizes per environment: use --impl jax")
