"""Canonical scenes of free bodies: what mechanics predicts of them, held by an integrator that errs little."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.integrate import solve_ivp

from benchmarks.law_changes import Change
from benchmarks.law_power import Setting, measured
from gpusimbench import open_recording
from gpusimbench.evaluator.metrics.physics.closed_form import falling_time, rotation_period
from gpusimbench.evaluator.metrics.physics.gravity import bounce
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.state_array import StateArray
from gpusimbench.evaluator.results.canonical import Law, laws
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.results.faults import faults
from gpusimbench.evaluator.runs.physics.canonical.motion import unevenness
from gpusimbench.evaluator.runs.physics.measure import physics_of
from tests.conftest import call

Array = npt.NDArray[np.float64]

_COMMON = ("--sim", "mujoco", "--n-env", "6", "--runs", "1", "--phases", "capture", "--seed", "3", "--no-view")


def _recorded(folder: Path, *asked: str) -> Path:
    done = call("gsb-record", *_COMMON, *asked, "--out", folder, code=0)
    return Path(done.stdout.split()[0])


def _laws(path: Path) -> dict[str, dict[str, Any]]:
    found = [law for law in laws("a", [physics_of(Recording(path))]) if isinstance(law, Law)]
    return {law.key: {**vars(law), "sensitivities": [vars(one) for one in law.sensitivities]} for law in found}


@pytest.fixture(scope="module")
def turning(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Free bodies by Runge-Kutta on MuJoCo C; every environment has disturbances of its own."""
    asked = ("--scene", "free-body", "--initial", "random:0.8", "--option", "integrator=RK4", "--dt", "0.02")
    return _recorded(tmp_path_factory.mktemp("turning"), *asked, "--steps", "800")


@pytest.mark.parametrize("spin", [(0.2, 5.0, 0.2), (5.0, 0.3, 0.1), (0.1, 0.3, 5.0), (1.0, 2.0, -3.0)])
def test_the_period_of_a_free_body_is_that_of_eulers_equations(spin: tuple[float, ...]) -> None:
    """Return to the same angular velocity after the period, and to no other before, by integration in small steps."""
    moments = np.array([5.0, 10.0, 13.0]) / 1200.0
    i1, i2, i3 = moments

    def euler(_: float, w: Array) -> list[float]:
        return [(i2 - i3) / i1 * w[1] * w[2], (i3 - i1) / i2 * w[2] * w[0], (i1 - i2) / i3 * w[0] * w[1]]

    period = float(rotation_period(moments, np.array(spin)))
    solved = solve_ivp(euler, (0.0, period), spin, rtol=1e-12, atol=1e-12, dense_output=True)
    assert np.allclose(solved.sol(period), spin, atol=1e-7)
    assert np.abs(solved.sol(np.linspace(0.1, 0.9, 50) * period) - np.array(spin)[:, None]).max(axis=0).min() > 0.05


def test_a_body_about_its_middle_axis_never_returns() -> None:
    """Give no finite period to the motion between both kinds, which ends at the middle axis."""
    assert math.isinf(float(rotation_period(np.array([5.0, 10.0, 13.0]), np.array([0.0, 5.0, 0.0]))))


def test_disturbances_are_drawn(turning: Path) -> None:
    """Draw angular velocities about all axes for every body and environment, within the share that the scene says."""
    recording = open_recording(turning)
    spin = recording.state("boxes", "angular_velocity").read(slice(0, 1), slice(None))[0]
    start = np.array([[0.2, 0.2, 5.0], [0.2, 5.0, 0.2], [5.0, 0.2, 0.2]])  # x of the box is y of the world
    added = spin - start
    assert np.abs(added).max() <= 0.3 * 0.8 + 1e-12 and np.ptp(added, axis=0).min() > 0.1
    assert not recording.state("boxes", "linear_velocity").read(slice(0, 1), slice(None)).any()


def test_runge_kutta_keeps_the_laws_of_free_bodies(turning: Path) -> None:
    """Hold momentum, energy and period of all three bodies within far less than the tolerance."""
    found = _laws(turning)
    assert set(found) == {f"{n}_{w}" for n in ("middle", "long", "short") for w in ("momentum", "energy", "period")}
    assert all(law["held"] and law["count"] == 6 for law in found.values())
    assert all(abs(law["difference"]) < 2e-5 for law in found.values())
    (mass, middle), (_, long) = (found[f"{name}_period"]["sensitivities"] for name in ("middle", "long"))
    assert mass["least"] is None and 0 < middle["least"] < 1e-2
    assert 0 < long["least"] < long["breaks"] < 1e-2
    assert middle["breaks"] is None  # with another moment, some periods of the body that flips rise and others fall


def test_the_middle_moment_moves_the_period_by_the_slope(turning: Path) -> None:
    """Agree with periods of bodies whose middle moment is larger and smaller by 1 in 10,000, mean over environments."""
    spin = open_recording(turning).state("boxes", "angular_velocity").read(slice(0, 1), slice(None))[0, :, 1]
    slopes = []
    for x, y, z in spin:  # the edges of the box, longest first, begin along y, z and x of the world
        more, less = (
            float(rotation_period(np.array([5.0, 10.0 * share, 13.0]) / 1200.0, np.array([y, z, x])))
            for share in (1.0001, 0.9999)
        )
        slopes.append((more - less) / 2e-4)
    _, found = _laws(turning)["long_period"]["sensitivities"]
    assert found["slope"] == pytest.approx(np.mean(slopes), rel=1e-6)


def test_a_change_that_moves_environments_both_ways_is_uneven_without_bound() -> None:
    """Take the coefficient of variation where all move one way."""
    assert unevenness(np.array([1.0, 2.0, 3.0])) == unevenness(-np.array([1.0, 2.0, 3.0])) == pytest.approx(0.5)
    assert unevenness(np.array([2.0, 2.0])) == unevenness(np.array([2.0])) == unevenness(np.zeros(3)) == 0.0
    assert math.isinf(unevenness(np.array([-0.1, 2.0, 3.0])))


@pytest.mark.slow
def test_a_step_that_is_too_long_for_the_middle_axis_shows(tmp_path: Path) -> None:
    """See the default integrator take energy from the body that flips, and none from that about its short axis."""
    found = _laws(_recorded(tmp_path, "--scene", "free-body", "--initial", "random:0.8"))
    assert not found["middle_energy"]["held"] and abs(found["middle_energy"]["difference"]) > 0.1
    assert found["short_energy"]["held"] and found["short_momentum"]["held"]


@pytest.mark.parametrize(("integrator", "implicit"), [("Euler", False), ("implicitfast", True)])
def test_the_sign_of_the_drift_is_that_of_eulers_method(tmp_path: Path, integrator: str, implicit: bool) -> None:
    """Gain what the gyroscopic torque adds when it is taken from the start of the step, and lose what it takes when it
    is linearised to the end of the step, as docs/physics/engines.md says of MuJoCo's integrators."""
    asked = ("--scene", "free-body", "--option", f"integrator={integrator}", "--steps", "400")
    gained = _laws(_recorded(tmp_path, *asked))["middle_energy"]["measured"]
    moments, dt = np.array([5.0, 10.0, 13.0]) / 1200.0, 0.01

    def turned(spin: Array) -> Array:
        return np.asarray(np.cross(moments * spin, spin) / moments)

    spin = np.array([0.2, 5.0, 0.2])
    for _ in range(400):
        # the torque is quadratic, so that these differences are its derivative
        slope = np.stack([(turned(spin + axis) - turned(spin - axis)) / 2.0 for axis in np.eye(3)], axis=1)
        spin = spin + np.linalg.solve(np.eye(3) - implicit * dt * slope, dt * turned(spin))
    expected = float(moments @ spin**2) / float(moments @ np.array([0.2, 5.0, 0.2]) ** 2) - 1.0
    assert gained == pytest.approx(expected, rel=1e-6) and (gained < 0.0) is implicit


def test_damping_moves_energy_and_momentum_as_told(turning: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Take from every angular velocity what a damping would have taken, and see it change the laws by their slopes."""
    damping, dt = 1e-3, 0.02

    def damped(read: Callable[..., Any]) -> Callable[..., Any]:
        def made(self: StateArray, rows: slice, envs: slice) -> Any:
            found = read(self, rows, envs)
            if self.field.field != "angular_velocity":
                return found
            return found * np.exp(-damping * dt * np.arange(len(found)))[:, None, None, None]

        return made

    (before,) = [laws("a", [physics_of(Recording(turning))])]
    with monkeypatch.context() as patch:
        patch.setattr(StateArray, "read", damped(StateArray.read))
        after = laws("a", [physics_of(Recording(turning))])
    for one, other in zip(before, after, strict=True):
        assert isinstance(one, Law) and isinstance(other, Law)
        least = {s.parameter: s.least for s in one.sensitivities}.get("angular damping")
        if least is not None:
            expected = damping * dt * 800 * (1 if one.key.endswith("momentum") else -2)
            assert 0.0 < least < 10 * damping
            assert other.difference == pytest.approx(expected, rel=0.02)


def _bouncing(restitution: float, *, dt: float = 0.001, touching: float = 0.012) -> tuple[Array, Array, Array]:
    """Time, height and speed of an exact fall from 0.5 m at -0.3 m/s, a contact that lasts, and an exact flight."""
    time = np.arange(1200) * dt
    contact = float(falling_time(np.array(0.5), np.array(-0.3), 9.81))
    met = 0.3 + 9.81 * contact
    since = time - contact - touching
    falling, flying = time < contact, since >= 0.0
    height = np.where(falling, 0.5 - 0.3 * time - 9.81 * time**2 / 2, -0.001)
    height = np.where(flying, restitution * met * since - 9.81 * since**2 / 2, height)
    turning = met * ((1.0 + restitution) * (time - contact) / touching - 1.0)
    speed = np.where(falling, -0.3 - 9.81 * time, np.where(flying, restitution * met - 9.81 * since, turning))
    return time, height, speed


@pytest.mark.parametrize("restitution", [0.2, 0.6, 1.0])
def test_a_bounce_is_read_off_the_flights_before_and_after(restitution: float) -> None:
    """Find time of contact and both speeds exactly, in float64 and in float32."""
    time, height, speed = _bouncing(restitution)
    contact = (-0.3 + math.sqrt(0.3**2 + 2 * 9.81 * 0.5)) / 9.81
    for made, within in ((np.float64, 1e-9), (np.float32, 1e-5)):
        found = bounce(time, height.astype(made).astype(float), speed.astype(made).astype(float), 9.81)
        assert found.time == pytest.approx(contact, abs=within)
        assert found.after / found.before == pytest.approx(restitution, abs=10 * within)


def test_a_ball_that_stays_has_no_rebound() -> None:
    """Give 0 to a ball that comes to rest, and nothing where the record ends too early or has no contact."""
    time, height, speed = _bouncing(0.6)
    down = int(np.argmax(height < 0.0))
    height[down:], speed[down:] = 0.0, 0.0
    assert bounce(time, height, speed, 9.81).after == 0.0
    cut = down + 5
    assert math.isnan(bounce(time[:cut], height[:cut], speed[:cut], 9.81).after)
    assert math.isnan(bounce(time[: down - 5], height[: down - 5], speed[: down - 5], 9.81).time)


def test_mujoco_measures_a_restitution_that_nothing_predicts(tmp_path: Path) -> None:
    """Judge the time of contact and the energy, and measure the rebound without a verdict."""
    asked = ("--scene", "ball-drop", "--initial", "random:0.5", "--option", "solref=0.02 0.2")
    path = _recorded(tmp_path, *asked, "--steps", "1000", "--dt", "0.001")
    found = _laws(path)
    assert set(found) == {f"{n}_{w}" for n in ("low", "middle", "high") for w in ("contact", "restitution", "gain")}
    for name in ("low", "middle", "high"):
        assert found[f"{name}_contact"]["held"] and found[f"{name}_gain"]["held"]
        rebound = found[f"{name}_restitution"]
        assert rebound["held"] is None and rebound["predicted"] is None and rebound["difference"] is None
        assert rebound["held_missing"] == "the engine has no coefficient of restitution in force"
        assert 0.5 < rebound["ci95"][0] < rebound["measured"] < rebound["ci95"][1] < 0.6
        assert 0.0 < rebound["sd"] < 0.1
    (result,) = evaluate_files([path]).results
    assert faults(result).laws == ""
    said = " ".join(call("gsb-eval", path).stdout.split())
    assert "6 of 6 laws in closed form held; without a verdict: restitution of the ball from 0.2 m 0.5" in said
    assert "no verdict" in call("gsb-eval", path, "--all").stdout
    (group,) = json.loads(call("gsb-eval", path, "--json", "-").stdout)["groups"]
    assert [law["predicted"] for law in group["laws"]].count(None) == 3
    assert not any(law["missing"] for law in group["laws"])


@pytest.mark.slow
def test_a_contact_that_is_too_fast_for_the_step_gains_energy(tmp_path: Path) -> None:
    """Call the bounce of MuJoCo's underdamped contacts broken at a step of 10 ms."""
    asked = ("--scene", "ball-drop", "--initial", "random:0.5", "--option", "solref=0.02 0.2")
    found = _laws(_recorded(tmp_path, *asked))
    assert not found["low_gain"]["held"] and found["low_gain"]["difference"] > 1.0


@pytest.mark.slow
def test_an_engine_is_held_to_the_restitution_that_it_was_given(tmp_path: Path) -> None:
    """Hold Newton's XPBD, which has one, to the scene's 0.6, and say how small a change of it would show."""
    pytest.importorskip("newton")
    asked = ("--sim", "newton", "--option", "solver=xpbd", "--option", "restitution=on")
    found = _laws(_recorded(tmp_path, *asked, "--scene", "ball-drop", "--initial", "random:0.5"))
    for name in ("low", "middle", "high"):
        rebound = found[f"{name}_restitution"]
        assert rebound["predicted"] == 0.6 and rebound["held"]
        least = {one["parameter"]: one["least"] for one in rebound["sensitivities"]}
        assert least["mass"] is None and 0 < least["restitution"] < 0.2


@pytest.mark.slow
def test_a_stride_hides_a_bounce(tmp_path: Path) -> None:
    """Say that a contact is shorter than the time between two states."""
    done = call("gsb-record", *_COMMON, "--scene", "ball-drop", "--stride", "5", "--out", tmp_path)
    said = " ".join(call("gsb-eval", done.stdout.split()[0]).stdout.split())
    assert "only every 5th state was recorded" in said


def test_another_gravity_moves_the_time_of_contact() -> None:
    """Read the time of the contact of a ball that falls with another gravity than it was told, and break no other."""
    time, height, speed = _bouncing(0.6)
    right = bounce(time, height, speed, 9.81)
    told = bounce(time, height, speed, 9.81 / 0.85)  # the ball falls with 15 % less than that
    assert told.time == pytest.approx(right.time, abs=1e-9)
    assert told.after / told.before == pytest.approx(0.6, abs=1e-9)
    assert math.isnan(bounce(time, height, speed, 9.81 * 2.0).time)  # which is no fall


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["implicitfast", "Euler"])
def test_a_damping_adds_to_the_drift_as_claimed(integrator: str, tmp_path: Path) -> None:
    """Take what the laws say that a damping takes from a body that flips, whose energy drifts by itself."""
    damping, found = 5e-4, []
    setting = Setting("mujoco", "free-body", 0.01, tmp_path, {"integrator": integrator})
    for changes in ((), [Change("angular damping", "middle", damping)]):
        found.append({law.key: law for law in measured(setting, changes, 1)})
    before, after = found
    slopes = {key: dict(before[key].slopes)["angular damping"] for key in ("middle_momentum", "middle_energy")}
    for key, slope in slopes.items():
        moved = np.subtract(after[key].measured, before[key].measured).mean() / damping
        assert moved == pytest.approx(slope, rel=0.1)
    assert slopes["middle_energy"] < 0.0
    assert (slopes["middle_momentum"] > 0.0) is (integrator == "implicitfast")  # Euler adds momentum, damping takes it
