"""Contacts that lie where their bodies are not: the definition, and what engines count of it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from gpusimbench import open_recording
from gpusimbench.recorder.scenes.registry import SCENES, make_scene
from gpusimbench.recorder.simulators.evidence import MISPLACED_CONTACTS
from gpusimbench.recorder.simulators.mujoco.contacts import misplaced
from tests.conftest import call
from tests.recorder import engines
from tests.recorder.engines import PAIR
from tests.recorder.mixed_model import scene_of
from tests.scripts import script

engines.needed("mujoco")

CUBES = """
<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody>
<body name="a"><freejoint/><geom type="box" size=".01 .01 .01" mass=".005"/></body>
<body name="b" pos=".05 0 0"><freejoint/><geom type="box" size=".01 .01 .01" mass=".005"/></body>
</worldbody></mujoco>
"""
"""The cubes of docs/far_contact.py."""

_FIELDS = ("position", "orientation", "linear_velocity", "angular_velocity")


def poses(n_env: int) -> dict[str, NDArray[np.float32]]:
    """The states of docs/far_contact.py, at rest, by field [env, cube, width]."""
    made = script("far_contact").neighbours()[:n_env].reshape(n_env, 2, 7)
    rest = np.zeros((n_env, 2, 3), np.float32)
    return dict(zip(_FIELDS, (made[..., :3], made[..., 3:], rest, rest), strict=True))


def counted(name: str, folder: Path, n_env: int, n_step: int, **options: Any) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Misplaced contacts [step, env] of the cubes on an engine, and which environments stay finite, [env]."""
    simulator, _ = engines.build(name, scene_of(CUBES, folder), n_env=n_env, **options)
    simulator.set_state(tuple(poses(n_env).values()))
    states = simulator.states(n_step)
    finite = np.all([np.isfinite(array).all(axis=(0, 2, 3)) for array in states], axis=0)
    evidence = simulator.evidence()
    assert evidence is not None
    return evidence.counts[MISPLACED_CONTACTS.name], finite


def _shapes(seed: int, thin: float) -> tuple[NDArray[Any], ...]:
    # two boxes in any place and pose, a point of each, and their centres and bounding radii
    rng = np.random.default_rng(seed)
    half = 10.0 ** rng.uniform(-3, 2, size=(2, 3))
    half[:, 2] *= thin
    axes = np.linalg.qr(rng.normal(size=(2, 3, 3)))[0]
    centres = rng.normal(size=(2, 3)) * 10.0 ** rng.uniform(-3, 2)
    inside = rng.uniform(-1, 1, size=(2, 3))
    points = centres + np.einsum("sij,sj->si", axes, half * inside)
    return points, centres, np.linalg.norm(half, axis=1)


@given(seed=st.integers(0, 2**32 - 1), thin=st.floats(1e-6, 1), share=st.floats(0, 1))
def test_a_contact_of_two_shapes_is_never_misplaced(seed: int, thin: float, share: float) -> None:
    """Place the contact anywhere between a point of each shape, at any depth, margin, size and aspect."""
    points, centres, radii = _shapes(seed, thin)
    apart = np.linalg.norm(points[1] - points[0])
    contact = points[0] + share * (points[1] - points[0])
    for distance in (apart, -apart):
        assert not misplaced(contact, distance, centres, radii)
    # nor where the sphere is around another point of the shape, such as that of a mesh
    assert not misplaced(contact, apart, points, radii)


@given(
    seed=st.integers(0, 2**32 - 1),
    beyond=st.floats(1.001, 1e6),
    side=st.integers(0, 1),
    power=st.integers(-20, 20),
)
def test_a_contact_beyond_either_shape_is_misplaced(seed: int, beyond: float, side: int, power: int) -> None:
    """Say so whichever of the shapes it is outside of, in any unit; and not of a shape without a bound."""
    _, centres, radii = _shapes(seed, 1.0)
    rng = np.random.default_rng(seed)
    distance, away = rng.normal() * radii.min(), rng.normal(size=3)
    contact = centres[side] + away / np.linalg.norm(away) * (2 * radii[side] + abs(distance)) * beyond
    unit = 2.0**power
    assert misplaced(contact * unit, distance * unit, centres * unit, radii * unit)
    assert not misplaced(contact, distance, centres, np.zeros(2))
    only = np.where(np.arange(2) == side, radii, 0)
    assert misplaced(contact, distance, centres, only)
    assert not misplaced(np.full(3, np.nan), distance, centres, radii)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n_env=st.integers(1, 4), varied=st.booleans())
def test_kernel_and_jax_are_the_formula(seed: int, n_env: int, varied: bool) -> None:
    """Count on a device what numpy counts, of contacts some of which have no geom or are not used."""
    engines.needed("mujoco_warp")
    engines.needed("mujoco.mjx")
    import jax.numpy as jnp
    import warp as wp

    from gpusimbench.recorder.simulators.mjx.physics import _misplaced
    from gpusimbench.recorder.simulators.warp import kernels

    rng = np.random.default_rng(seed)
    n_geom, size, used = 5, 40, 33
    points, distances = rng.normal(size=(size, 3)).astype(np.float32), rng.normal(size=size).astype(np.float32) / 4
    geoms = rng.integers(-1, n_geom, size=(size, 2)).astype(np.int32)
    env = rng.integers(0, n_env, size=size).astype(np.int32)
    centres = rng.normal(size=(n_env, n_geom, 3)).astype(np.float32)
    radii = rng.uniform(0.1, 1, size=(n_env if varied else 1, n_geom)).astype(np.float32)
    radii[:, 0] = 0
    of = np.where(geoms < 0, 0, radii[env[:, None] % len(radii), geoms])
    expected = misplaced(points, distances, centres[env[:, None], geoms], of)
    counts = np.bincount(env[:used], weights=expected[:used], minlength=n_env)
    assert 0 < expected.sum() < size

    traced = _misplaced(points, distances, geoms, env, SimpleNamespace(geom_xpos=jnp.asarray(centres)), radii)
    assert np.asarray(traced).tolist() == expected.tolist()
    with wp.ScopedDevice("cpu"):
        found = wp.zeros((2, n_env), dtype=int)
        arrays = [env, (geoms, wp.vec2i), (points, wp.vec3), distances, (centres, wp.vec3), radii]
        given_arrays = [wp.array(*a) if isinstance(a, tuple) else wp.array(a) for a in arrays]
        nacon, row = wp.array([used], dtype=int), wp.array([1], dtype=int)
        wp.launch(kernels.count_misplaced, dim=size, inputs=[row, nacon, *given_arrays], outputs=[found])
        assert found.numpy().tolist() == [[0] * n_env, counts.tolist()]


@pytest.mark.parametrize("name", SCENES)
def test_mujoco_c_places_contacts_at_their_bodies(name: str) -> None:
    """Count none in any scene on the reference engine."""
    simulator, description = engines.build("mujoco", make_scene(name), stepping="mj_step")
    assert MISPLACED_CONTACTS in description.counters
    simulator.states(100)
    evidence = simulator.evidence()
    assert evidence is not None
    assert not evidence.counts[MISPLACED_CONTACTS.name].any()


def test_a_batch_shows_no_contacts() -> None:
    """Declare no counter where MuJoCo's batch gives no contacts, in place of zeros."""
    _, description = engines.build("mujoco", PAIR, stepping="batch")
    assert MISPLACED_CONTACTS not in description.counters


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("warp", {}),
        pytest.param("newton", {"solver": "mujoco"}, marks=pytest.mark.slow),
        pytest.param("mjx", {"impl": "warp"}, marks=pytest.mark.slow),
        pytest.param("playground", {"impl": "warp"}, marks=pytest.mark.slow),
    ],
)
def test_contacts_far_away_are_counted(name: str, options: dict[str, str], tmp_path: Path) -> None:
    """Count a contact that lies kilometres away, in the step that has it, on each engine on MuJoCo Warp."""
    found, _ = counted(name, tmp_path, 64, 1, **options)
    assert found.shape == (1, 64)
    assert found[0, 0] == 1
    assert 0 < found.sum() < 64


def test_a_recording_tells(tmp_path: Path) -> None:
    """Find in recordings the contacts that MuJoCo Warp misplaces, in runs that are complete, and none of MuJoCo C."""
    engines.needed("mujoco_warp")
    found, finite = counted("warp", tmp_path, 256, 3)
    chosen = np.flatnonzero(found.any(axis=0) & finite)[:4]
    assert len(chosen)
    (tmp_path / "cubes.xml").write_text(CUBES)
    np.savez(tmp_path / "poses.npz", **{f"bodies/{name}": a[chosen] for name, a in poses(256).items()})
    asked = (
        "--model",
        "cubes.xml",
        "--initial",
        "poses.npz",
        "--n-env",
        str(len(chosen)),
        "--runs",
        "1",
        "--steps",
        "3",
    )
    for name, expected in (("warp", found[:, chosen]), ("mujoco", np.zeros((3, len(chosen))))):
        how = ("--option", "stepping=mj_step") if name == "mujoco" else ()
        call("gsb-record", "--sim", name, *asked, "--phases", "capture", *how, "--out", name, cwd=tmp_path)
        (path,) = (tmp_path / name).glob("*.mcap")
        recording = open_recording(path)
        assert recording.status == "complete"
        counts = recording.counts["capture"][MISPLACED_CONTACTS.name]
        assert (counts.mean * len(chosen)).round().tolist() == expected.sum(axis=1).tolist()
        said = call("gsb-eval", path).stdout
        checked = call("gsb-check", path).stdout
        assert ("no: 1 of 1 run: misplaced contacts" in said) == (name == "warp")
        assert ("warning misplaced-contacts" in checked) == (name == "warp")
