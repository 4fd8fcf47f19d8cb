"""The canonical scene of dice: orientations that are uniform at the start, faces that are as likely at the end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chisquare, kstest

from gpusimbench import open_recording
from gpusimbench.evaluator.metrics.physics.solids import rotations
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.results.canonical import Law, laws
from gpusimbench.evaluator.runs.physics.canonical.dice import faces
from gpusimbench.evaluator.runs.physics.facts import LawCounts, PhysicsFacts
from gpusimbench.evaluator.runs.physics.measure import physics_of
from gpusimbench.evaluator.statistics.families import uniformity
from gpusimbench.recorder.run.start import orientations
from gpusimbench.schemas.initial import Initial
from tests.conftest import call

_N_ENV = 20
_DICE = 12


def _recorded(folder: Path, *asked: str) -> Path:
    common = ("--sim", "mujoco", "--runs", "1", "--phases", "capture", "--seed", "3", "--no-view", "--scene")
    done = call("gsb-record", *common, "dice-drop", *asked, "--out", folder, code=0)
    return Path(done.stdout.split()[0])


@pytest.fixture(scope="module")
def thrown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Dice of MuJoCo C that begin with orientations of their own."""
    return _recorded(tmp_path_factory.mktemp("dice"), "--n-env", str(_N_ENV), "--initial", "random:0.8")


def _facts(*counts: tuple[int, ...], of: int) -> list[PhysicsFacts]:
    made = [LawCounts("faces", "faces on top", one, of, "they moved") for one in counts]
    return [PhysicsFacts("dice-drop", 1, ((0, 0),), {}, laws=(one,)) for one in made]


def test_orientations_are_uniform_over_rotations() -> None:
    """Give every axis of the body every direction alike, by the heights of its ends, and every body its own."""
    drawn = orientations(Initial.parse("random:0.5"), 7, 1, (400, 12))
    assert np.allclose((drawn**2).sum(axis=-1), 1.0, atol=1e-12)
    assert len(np.unique(drawn.reshape(-1, 4), axis=0)) == 400 * 12
    matrices = rotations(drawn.reshape(-1, 4))
    for place in np.ndindex(3, 3):
        assert kstest(matrices[:, *place], "uniform", (-1.0, 2.0)).pvalue > 1e-3
    shifted = orientations(Initial.parse("random:0.5,shift:5"), 7, 1, (400, 12))
    assert np.array_equal(shifted, np.roll(drawn, -5, axis=0))


def test_dice_begin_turned_and_end_level(thrown: Path) -> None:
    """Set the drawn orientations as they are, and leave the places of the dice."""
    recording = open_recording(thrown)
    first = recording.state("cubes", "orientation").read(slice(0, 1), slice(None))[0]
    assert np.allclose((first**2).sum(axis=-1), 1.0) and np.ptp(first[..., 0]) > 1.0
    assert not np.ptp(recording.state("cubes", "position").read(slice(0, 1), slice(None))[0], axis=0).any()


def test_faces_of_known_orientations() -> None:
    """Name the face that a quarter turn brings up, and call no face level that leans by 10 degrees."""
    half, angle = np.sqrt(0.5), np.radians(10.0) / 2
    turns = np.array(
        [[1, 0, 0, 0], [0, 1, 0, 0], [half, half, 0, 0], [half, -half, 0, 0], [half, 0, half, 0], [half, 0, -half, 0],
         [np.cos(angle), np.sin(angle), 0, 0]]
    )  # fmt: skip
    face, level = faces(turns)
    assert face.tolist() == [2, 5, 1, 4, 3, 0, 2]
    assert level.tolist() == [True] * 6 + [False]


def test_mujoco_lets_every_face_come_up(thrown: Path) -> None:
    """Count nearly all dice at rest, hold the law, and print what it would see."""
    (law,) = laws("a", [physics_of(Recording(thrown))])
    assert isinstance(law, Law) and law.held and law.predicted == 5.0
    assert 0.95 * law.of_envs < law.count <= law.of_envs == _N_ENV * _DICE
    (seen,) = law.sensitivities
    assert seen.parameter == "probability of a face" and 0.4 < (seen.least or 0.0) < 1.0
    said = " ".join(call("gsb-eval", thrown, "--all").stdout.split())
    assert (
        "faces on top" in said
        and "insensitive" not in said
        and "1 of 1 law in closed form held" in " ".join(call("gsb-eval", thrown).stdout.split())
    )


def test_dice_that_begin_alike_say_nothing(tmp_path: Path) -> None:
    """Ask for drawn orientations, and for enough dice."""
    found = physics_of(Recording(_recorded(tmp_path, "--n-env", "2", "--steps", "20"))).laws
    assert isinstance(found, Missing) and "begin alike" in found.reason
    (law,) = laws("a", _facts((4, 5, 5, 5, 5, 5), of=40))
    assert law.reason == "29 of 40 throws have an outcome, and 5 are needed for each outcome"


def test_a_loaded_die_is_broken_and_runs_are_no_further_throws() -> None:
    """Agree with SciPy's test; count the dice of the first run only, since all runs begin alike."""
    fair, loaded = (160, 170, 165, 171, 159, 175), (150, 150, 150, 150, 150, 250)
    (law,) = laws("a", _facts(fair, fair, fair, of=1001))
    assert isinstance(law, Law) and law.held and law.count == 1000 and law.left_out == ("they moved",)
    assert (law.measured, law.p_value) == pytest.approx((chisquare(fair).statistic, chisquare(fair).pvalue))
    (law,) = laws("a", _facts(loaded, of=1000))
    assert isinstance(law, Law) and not law.held and law.left_out == ()


def test_the_smallest_load_is_seen_95_times_in_100() -> None:
    """See a face whose probability is off by the printed share with the printed power, by counting."""
    test = uniformity((1000,) * 6, alpha=0.05, power=0.95)
    assert test is not None and test.statistic == 0.0 and test.p == 1.0
    rng, chances = np.random.default_rng(4), np.full(6, (1.0 - test.least / 5) / 6)
    chances[2] = (1.0 + test.least) / 6
    for p, rate in ((chances, 0.95), (np.full(6, 1 / 6), 0.05)):
        counts = rng.multinomial(6000, p, size=4000)
        seen = ((counts - 1000.0) ** 2).sum(axis=1) / 1000.0 > test.critical
        assert seen.mean() == pytest.approx(rate, abs=0.015)
    assert uniformity((4,) * 6, alpha=0.05, power=0.95) is None
    assert uniformity((5,) * 6, alpha=0.05, power=0.95) is not None  # the usual rule: five expected of each
