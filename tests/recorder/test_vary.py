"""gsb-record --vary: environments whose masses, frictions and sizes differ."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench import open_recording
from gpusimbench.recorder.run.draws import GRID
from gpusimbench.recorder.run.vary import attachment, parse, variation
from gpusimbench.recorder.scenes.base import Box, Scene, Sphere
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.scenes.variation import Variation, varied_items
from gpusimbench.recorder.simulators.mujoco.model import compile_scene, compile_varied, varied_fields
from gpusimbench.recorder.simulators.mujoco.options import MjcfOptions
from gpusimbench.schemas import arrays
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DamagedRecording, UsageError
from gpusimbench.schemas.treatment import QUANTITIES, VARIED, VARIED_SPREAD, Vary
from tests.conftest import Command, call, run_python

VARY = "mass:0.3,friction:0.5,size:0.01"
_SHORT = ("--steps", "80", "--phases", "capture", "--seed", "7", "--runs", "1")

spreads = st.dictionaries(st.sampled_from(sorted(QUANTITIES)), st.floats(GRID, VARIED_SPREAD), min_size=1)


def drawn(text: str, *, scene: str = "inclined-collision", n_env: int = 4, seed: int = 7) -> Variation:
    """Parameters of environments."""
    found = variation(text, make_scene(scene), n_env=n_env, seed=seed)
    assert found is not None
    return found


def recorded(folder: Path, *arguments: str) -> Path:
    """A run of MuJoCo C."""
    done = call("gsb-record", "--sim", "mujoco", *_SHORT, *arguments, "--out", folder, code=0)
    return Path(done.stdout.strip())


@pytest.fixture(scope="module")
def varied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four environments of MuJoCo C whose parameters differ."""
    return recorded(tmp_path_factory.mktemp("varied"), "--n-env", "4", "--vary", VARY)


@given(spreads, st.integers(0, 99), st.none() | st.integers(0, 99))
def test_written_and_read(given_spreads: dict[str, float], shift: int, but: int | None) -> None:
    """Read the text back as it is written, in one order."""
    ordered = tuple((name, given_spreads[name]) for name in QUANTITIES if name in given_spreads)
    made = Vary(ordered, shift if but is None else 0, but)
    assert Vary.parse(str(made)) == made
    assert Vary.parse(",".join(f"{name}:{spread!r}" for name, spread in given_spreads.items())) == made.usual


@pytest.mark.parametrize(
    "text",
    [
        "", "mass", "mass:", "mass:0", "mass:-0.1", "mass:0.91", "mass:nan", "mass:x", "colour:0.1",
        "mass:0.1,mass:0.1",
        "mass:0.1,shift:-1", "mass:0.1,shift:1,but:1", "shift:1", "mass:0.1,but:4", "mass:1e-9", "mass:0.1 ,size:0.1",
    ],
)  # fmt: skip
def test_no_parameters(text: str) -> None:
    """Refuse what says nothing that can be drawn."""
    with pytest.raises(UsageError, match="--vary takes mass:SPREAD, friction:SPREAD, size:SPREAD"):
        parse(text, 4)


def test_in_a_recording() -> None:
    """Call a recording damaged that says it of parameters that are not known."""
    configuration = RunConfiguration("mujoco", "free-fall", 2, 0.01, 4, vary="mass:0.1")
    assert RunConfiguration.from_json(configuration.to_json()) == configuration
    assert "vary" not in replace(configuration, vary="").to_json()
    with pytest.raises(DamagedRecording, match="vary has an unknown value"):
        RunConfiguration.from_json({**configuration.to_json(), "vary": "colour:0.1"})


@given(st.integers(0, 2**64 - 1), st.floats(0.01, VARIED_SPREAD))
def test_factors(seed: int, spread: float) -> None:
    """Draw factors within the spread, other ones for each body, environment and quantity, whatever else is drawn."""
    both = drawn(f"mass:{spread!r},friction:{spread!r}", n_env=8, seed=seed)
    mass, friction = both.factors["mass"].values, both.factors["friction"].values
    assert mass.shape == (8, 28)
    assert np.abs(mass - 1).max() <= spread
    assert np.array_equal(mass.astype(np.float32), mass)
    assert np.abs(mass - friction).max() > 0
    assert len(np.unique(mass)) > 1
    assert np.array_equal(mass[:3], drawn(f"mass:{spread!r}", n_env=3, seed=seed).factors["mass"].values)


def test_factors_fill_the_spread() -> None:
    """Draw uniformly: both halves alike, and up to the ends."""
    factors = drawn("mass:0.2", n_env=2000, seed=1).factors["mass"].values
    assert abs(factors.mean() - 1) < 0.002
    assert abs(factors.std() - 0.2 / 3**0.5) < 0.002
    assert factors.min() < 0.801
    assert factors.max() > 1.199


def test_shifted() -> None:
    """Give each environment the parameters of the one K places further, and the last ones those of the first."""
    plain, shifted = (drawn(f"mass:0.2{tail}", n_env=5).factors["mass"].values for tail in ("", ",shift:2"))
    assert np.array_equal(shifted, np.roll(plain, -2, axis=0))


def test_all_but_one() -> None:
    """Leave one environment its parameters, and give every other one others."""
    plain, other = (drawn(f"mass:0.2{tail}", n_env=5).factors["mass"].values for tail in ("", ",but:1"))
    assert np.flatnonzero((plain == other).all(axis=1)).tolist() == [1]


def test_what_is_scaled() -> None:
    """Scale masses with inertia, friction of surfaces, and sizes with the mass left as it is; nothing that is fixed."""
    scene, found = make_scene("inclined-collision"), drawn(VARY)
    items = [body.name for body in scene.moving()]
    for env in range(4):
        mass, friction, size = (dict(zip(items, found.factors[name].values[env], strict=True)) for name in QUANTITIES)
        for before, after in zip(scene.bodies, found.of(scene, env).bodies, strict=True):
            if before.fixed:
                assert after == before
                continue
            name = before.name
            assert after.mass == before.mass * mass[name]
            assert after.material.kinetic_friction == before.material.kinetic_friction * friction[name]
            assert after.material.static_friction == before.material.static_friction * friction[name]
            assert after.material.restitution == before.material.restitution
            assert (after.position, after.orientation) == (before.position, before.orientation)
            if isinstance(before.shape, Sphere):
                assert after.shape == Sphere(before.shape.radius * size[name])
            else:
                assert isinstance(before.shape, Box)
                x, y, z = before.shape.size
                assert after.shape == Box((x * size[name], y * size[name], z * size[name]))


def test_compiled() -> None:
    """Compile of each environment the mass, the inertia of a solid of its size, and the friction that it is given."""
    scene, found = make_scene("inclined-collision"), drawn(VARY)
    models = compile_varied(scene, found, n_env=4, dt=0.01, options=MjcfOptions())
    for env, model in enumerate(models):
        ball = model.body("ball")
        of_ball = {name: factors.values[env, 0] for name, factors in found.factors.items()}
        radius, mass = 0.0175 * of_ball["size"], 0.17782 * of_ball["mass"]
        assert ball.mass[0] == pytest.approx(mass, rel=1e-12)
        assert ball.inertia == pytest.approx(np.full(3, 0.4 * mass * radius**2), rel=1e-9)
        assert model.geom("ball").friction[0] == pytest.approx(0.25 * of_ball["friction"], rel=1e-12)
    fields = varied_fields(compile_scene(scene, dt=0.01, options=MjcfOptions()).model, models)
    assert {"body_mass", "body_inertia", "body_subtreemass", "body_invweight0", "dof_invweight0"} <= fields.keys()
    assert {"geom_friction", "geom_size", "geom_rbound"} <= fields.keys()
    assert all(len(array) == 4 for array in fields.values())


def test_robots() -> None:
    """Vary the masses of all links that move, with their inertia, and the friction of the robot."""
    scene = make_scene("franka")
    found = drawn("mass:0.2,friction:0.2", scene="franka")
    assert found.factors["friction"].items == (scene.robot.name,)
    assert varied_items(scene, "size") == ()
    moving = [link.name for link in scene.robot.links[1:]]
    assert list(found.factors["mass"].items) == moving
    changed = found.of(scene, 1)
    for before, after in zip(scene.robot.links, changed.robot.links, strict=True):
        factor = dict(zip(moving, found.factors["mass"].values[1], strict=True)).get(before.name, 1.0)
        assert after.inertial.mass == before.inertial.mass * factor
        assert after.inertial.centre == before.inertial.centre
        assert after.inertial.inertia == tuple(factor * moment for moment in before.inertial.inertia)
    factor = found.factors["friction"].values[1, 0]
    assert changed.robot.material.kinetic_friction == scene.robot.material.kinetic_friction * factor


def test_what_a_recording_says(varied: Path) -> None:
    """Carry the text, and which environment had which factors; the file's digests cover both."""
    recording = open_recording(varied)
    assert recording.configuration.vary == VARY
    attached = recording.attachment(VARIED)
    assert attached == attachment(drawn(VARY))
    found = arrays.decode(VARIED, attached)
    assert found["mass"].shape == (4, 28)
    assert found["mass/items"][0] == "ball"


def test_recorded_as_written_into_the_scene(varied: Path) -> None:
    """Move each environment as MuJoCo moves the scene that is written with its parameters, bit for bit."""
    recording, scene = open_recording(varied), make_scene("inclined-collision")
    positions = np.asarray(recording.state("cubes", "position"))
    assert len({positions[:, env].tobytes() for env in range(4)}) == 4
    for env in range(4):
        assert np.array_equal(positions[:, env], simulated(drawn(VARY).of(scene, env), 80))


def simulated(scene: Scene, n_step: int) -> np.ndarray:
    """Positions of the cubes, [step, item, 3], by a loop over mj_step."""
    compiled = compile_scene(scene, dt=scene.dt, options=MjcfOptions())
    data = mujoco.MjData(compiled.model)
    data.qpos[:], data.qvel[:] = compiled.qpos0, compiled.qvel0
    rows = []
    for step in range(n_step + 1):
        rows.append(compiled.split(data.qpos.copy(), data.qvel.copy())[4].copy())
        if step < n_step:
            mujoco.mj_step(compiled.model, data)
    return np.array(rows)


def test_a_replay(varied: Path, gsb_record: Command, tmp_path: Path) -> None:
    """Replay with the same parameters, and say so."""
    done = gsb_record("--replay", varied, "--out", tmp_path, code=0)
    assert f"seed 7, vary {VARY}, 80 captured steps" in done.stderr
    one, other = open_recording(varied), open_recording(Path(done.stdout.strip()))
    assert one.attachment(VARIED) == other.attachment(VARIED)
    assert one.state("cubes", "position")[-1].tobytes() == other.state("cubes", "position")[-1].tobytes()


def test_a_snapshot_continued(gsb_record: Command, tmp_path: Path) -> None:
    """Continue a snapshot with the parameters of its environments, also where these are in other slots."""
    first = recorded(tmp_path, "--n-env", "3", "--vary", "mass:0.3,shift:1", "--snapshot", "40")
    done = gsb_record("--replay", first, "--from", "40", "--out", tmp_path / "later", code=0)
    one, other = open_recording(first), open_recording(Path(done.stdout.strip()))
    assert one.state("cubes", "position")[-1].tobytes() == other.state("cubes", "position")[-1].tobytes()


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (("--sim", "genesis", "--vary", "mass:0.1"), "'genesis' cannot do --vary mass:0.1: it has no masses per env"),
        (("--sim", "physx", "--vary", "mass:0.1,size:0.1"), "no masses per environment or sizes per environment"),
        (("--sim", "mujoco", "--scene", "franka", "--vary", "size:0.1"), "describes no body or robot whose size"),
        (("--sim", "mujoco", "--n-env", "2", "--vary", "mass:0.1,but:2"), "with ,but:E, an environment, not"),
    ],
)  # fmt: skip
def test_refused(arguments: tuple[str, ...], why: str, gsb_record: Command) -> None:
    """Refuse what cannot be done with the ability that is missing."""
    done = gsb_record(*arguments, code=2)
    assert why in done.stderr


def test_refused_before_any_import() -> None:
    """Refuse without importing an engine."""
    code = (
        "import sys; from gpusimbench.recorder.command.command import run\n"
        "try: run(['--sim', 'genesis', '--vary', 'mass:0.1'])\n"
        "except Exception as error: print(error)\n"
        "print(sorted({'mujoco', 'genesis', 'torch', 'jax', 'warp'} & sys.modules.keys()))"
    )
    done = run_python(code)
    assert done.stdout.splitlines()[-1] == "[]"
    assert "it has no masses per environment" in done.stdout


def test_listed(gsb_record: Command) -> None:
    """Name the abilities of a simulator that has them."""
    done = gsb_record("--list", "mujoco", "--json")
    assert "masses per environment" in json.loads(done.stdout)["simulator"]["abilities"]
