"""The page on friction in Madrona: its tables are those of the script and of the recordings that ship."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.conftest import run_python
from tests.reading import verified
from tests.scripts import drawn
from tests.scripts import script as script_beside

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def script() -> ModuleType:
    """docs/make_friction.py."""
    return script_beside("make_friction")


def test_the_page_is_as_the_script_draws_it(script: ModuleType) -> None:
    """Hold all tables to the formulas and to the recordings; make figures redraws them."""
    tables = script.page_tables()
    assert {name: drawn(script.PAGE, name) for name in tables} == tables


def test_the_recordings_are_whole_and_small(script: ModuleType) -> None:
    """Verify each, name the engine that was changed, and keep them together below 1 MB."""
    files = script.shipped()
    cases = {case.stem: case for case in (*script.PUBLISHED, *script.CHANGED)}
    assert {path.stem for path in files} == {*cases, "sapien"}
    for path in files:
        recording = verified(path)
        assert recording.status == "complete"
        assert not recording.provenance.software["recorder"]["modified"]
        name = script.measured(path)[0].partition(",")[0]
        if path.stem == "sapien":
            assert name == "sapien"
            continue
        case = cases[path.stem]
        assert name == ("madrona MODIFIED" if case.changed else "madrona")
        assert script.HEIGHTS[recording.configuration.scene] == case.height
        assert recording.simulation.options["num_substeps"] == case.substeps
    assert sum(path.stat().st_size for path in files) < 1e6


def test_what_the_page_concludes(script: ModuleType) -> None:
    """SAPIEN brakes by Coulomb's law; each Madrona as the substep predicts, at every mass that float32 shows."""
    coulomb = script.FRICTION * script.GRAVITY
    assert script.measured(script.SHIPPED / "sapien.mcap")[1] == pytest.approx(coulomb, rel=1e-3)
    for case in script.CHANGED:
        _, found = script.measured(script.SHIPPED / f"{case.stem}.mcap")
        assert found == pytest.approx(case.predicted(), rel=0.01)
    for case in script.PUBLISHED:
        _, found = script.measured(script.SHIPPED / f"{case.stem}.mcap")
        predicted, seen = case.predicted(), np.isfinite(found)
        assert seen.sum() >= 6
        assert (found[:3] < 0.03).all()
        assert found[seen][3:] == pytest.approx(predicted[seen][3:], rel=0.03)
        assert found[:3] == pytest.approx(predicted[:3], abs=3e-3)


def test_the_box_rocks_unless_it_is_tall(script: ModuleType) -> None:
    """The two normal impulses add up to the weight; only a box that rocks has a first that is above it."""
    del script  # which has docs on the path
    from madrona_substep import normal_impulses

    for friction, height in ((0.25, 1.0), (0.25, 0.2), (0.05, 1.0), (0.5, 1.0)):
        lift, given_back = normal_impulses(friction, height)
        assert lift + given_back == pytest.approx(1.0, abs=1e-3)
        assert abs(lift - 1.0) > 0.01
    lift, given_back = normal_impulses(0.25, 1.5)  # a box of 15 cm; Madrona made 1.002 of it
    assert lift == pytest.approx(1.0, abs=1e-3)


def test_a_corner_of_a_box_is_easier_to_move(script: ModuleType) -> None:
    """The generalised inverse mass from the inertia of a solid box, by its definition; four times 1/m for a cube."""
    from madrona_substep import corner_inverse_mass

    del script
    mass, edge = 0.7, 0.3
    for height in (1.0, 0.2):
        x, z = edge**2, (height * edge) ** 2
        inverse_inertia = np.diag([12 / (mass * (x + z)), 12 / (mass * (x + z)), 12 / (mass * 2 * x)])
        for corner in ((1, 1, -height), (-1, 1, -height), (1, -1, -height), (-1, -1, -height)):
            arm = np.cross(np.array(corner) * edge / 2, (1.0, 0.0, 0.0))
            assert 1 / mass + arm @ inverse_inertia @ arm == pytest.approx(corner_inverse_mass(height) / mass)
    assert corner_inverse_mass(1.0) == 4.0


def test_a_recording_of_another_scene_is_refused() -> None:
    """Say which file it is."""
    path = "recordings/mujoco-amd-r0.mcap"
    code = (
        f"import runpy, sys; sys.path.insert(0, 'docs'); sys.argv[1:] = [{path!r}]; "
        "runpy.run_path('docs/make_friction.py', run_name='__main__')"
    )
    done = run_python(code, cwd=ROOT, code=1)
    assert f"{path} is no recording of sliding-blocks or sliding-slabs" in done.stderr
