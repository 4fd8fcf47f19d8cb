"""The whole way from simulator to verdict, with a simulator whose answer is known: what was built in is found."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench import open_recording
from gpusimbench.recorder.environments.choice import interpreter_for
from gpusimbench.recorder.simulators.calibration.options import fraction
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas.errors import UsageError
from tests.conftest import call, finished

try:
    PYTHON = interpreter_for(find_simulator("calibration"))
except UsageError as _nowhere:
    pytest.skip(str(_nowhere), allow_module_level=True)

ROOT = Path(__file__).resolve().parents[1]

Json = dict[str, Any]

FEW = ("--steps", 5, "--phases", "capture")
"""States alone; evaluated at 0.05 s."""

KNOWN: Json = {"scene": "free-fall", "n_env": 5, "steps": 5, "phases": ["capture"]}
"""The same, as a configuration."""

MANY = """
import json, sys, uuid
from pathlib import Path
from gpusimbench.recorder.run.run import Run
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.provenance import Provenance
for index, task in enumerate(json.load(sys.stdin)):
    configuration = RunConfiguration(simulator="calibration", dt=0.01, run_index=index, **task)
    provenance = Provenance(str(uuid.uuid4()), "2026-01-01T00:00:00Z", (), configuration)
    run = Run(provenance, Path(sys.argv[1]) / f"{uuid.uuid4()}.mcap", progress=lambda *_: None, log=lambda: b"")
    assert run.record().status == "COMPLETE"
"""
"""Runs one after another in a process, where a process each would take minutes."""


def record(folder: Path, *arguments: object, **options: object) -> None:
    """One command: runs of inclined-collision, a process each."""
    given = [part for name, value in {"device": "cpu", **options}.items() for part in ("--option", f"{name}={value}")]
    call("gsb-record", "--sim", "calibration", *arguments, *given, "--out", folder, code=0)


def record_many(folder: Path, tasks: list[Json]) -> None:
    """Runs of these configurations, one after another in a process."""
    tasks = [{**task, "options": {"device": "cpu", **task["options"]}} for task in tasks]
    finished(
        PYTHON.command("-c", MANY, str(folder)), input=json.dumps(tasks), env=PYTHON.environment(folder), timeout=600
    )


def evaluate(folder: Path, seconds: float) -> Json:
    """The metrics of the only group of a folder."""
    (group,) = evaluated(folder, seconds)["groups"]
    return group["metrics"]


def evaluated(folder: Path, seconds: float) -> Json:
    """What gsb-eval says of a folder, positions at a time."""
    done = call("gsb-eval", *sorted(folder.glob("*.mcap")), "--sample-time", seconds, "--json", "-", code=0)
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    ("regime", "type_", "envs", "runs"),
    [
        ("identical", 2, 1, 1),
        pytest.param("offset", 1, 6, 1, marks=pytest.mark.slow),
        ("order", 3, 6, 2),
        pytest.param("run-order", 4, 1, 2, marks=pytest.mark.slow),
    ],
)
@pytest.mark.slow
def test_rounding_that_contacts_amplify(tmp_path: Path, regime: str, type_: int, envs: int, runs: int) -> None:
    """Return the type and the counts that each regime is made for, where contacts make centimetres of rounding."""
    arguments = ("--n-env", 6, "--runs", 2, "--steps", 150, "--warmup", 2, "--timed-steps", 40)
    record(tmp_path, *arguments, regime=regime)
    found = evaluate(tmp_path, 1.5)
    assert found["regime_published"]["value"] == type_
    assert found["distinct_envs"]["extra"]["per_run"] == [envs] * 2
    assert found["distinct_runs"]["value"] == runs
    # a run draws once, so that what is timed is what is captured
    assert (found["capture_changes_states"]["value"], found["capture_changes_states"]["n"]) == (0, 2)


@pytest.mark.slow
def test_one_ulp_in_one_env_of_4096(tmp_path: Path) -> None:
    """Find the one environment, the step, and nothing else: neither another environment nor a difference of runs."""
    record(tmp_path, *FEW, "--n-env", 4096, "--runs", 2, regime="offset", ulps=1, env=1234, at=3)
    found = evaluate(tmp_path, 5.0)
    assert found["distinct_envs"]["value"] == 2
    assert found["distinct_envs"]["extra"]["first_difference_step"] == 3
    for classes in found["distinct_envs"]["extra"]["classes"]:
        assert np.flatnonzero(classes).tolist() == [1234]
    assert found["distinct_runs"]["value"] == 1


@pytest.mark.slow
def test_one_ulp_becomes_centimetres(tmp_path: Path) -> None:
    """See in the published distances what contacts made of one unit in the last place: Type 1."""
    record(tmp_path, "--n-env", 4, "--runs", 2, "--steps", 200, "--phases", "capture", regime="offset", ulps=1, env=2)
    found = evaluate(tmp_path, 2.0)
    assert found["distinct_envs"]["extra"]["classes"] == [[0, 0, 1, 0]] * 2
    assert found["distinct_envs"]["extra"]["first_difference_step"] == 1
    assert found["w1_parallel"]["value"] > 0.1
    assert found["w1_run_to_run"]["value"] == 0
    assert found["regime_published"]["value"] == 1


def test_one_ulp_in_one_run_of_three(tmp_path: Path) -> None:
    """Tell the one run apart by bits, where the rounded distances, and so the published type, see nothing."""
    options = {"regime": "run-order", "ulps": "1", "at": "4"}
    record_many(tmp_path, [{**KNOWN, "options": {**options, "entropy": digits}} for digits in ("0", "f", "0")])
    found = evaluate(tmp_path, 0.05)
    assert found["distinct_envs"]["value"] == 1
    assert found["distinct_runs"]["value"] == 2
    assert found["distinct_runs"]["extra"]["classes"] == [0, 1, 0]
    assert found["distinct_runs"]["extra"]["first_difference_step"] == 4
    assert found["regime_published"]["value"] == 2


SIZES = [("order", 10.0**exponent) for exponent in range(-6, 2)] + [("offset", 0.01), ("run-order", 0.01)]
"""Regimes, and shifts from a micrometre to ten metres."""


def test_known_distances(tmp_path: Path) -> None:
    """Return distances that are known beforehand, over seven decades, within the rounding of float32."""
    drawn = ("0", "4", "c")  # 0, 1/4 and 3/4
    tasks = [
        {**KNOWN, "options": {"regime": regime, "shift": str(shift), "contacts": "off", "entropy": digits}}
        for regime, shift in SIZES
        for digits in drawn
    ]
    record_many(tmp_path, tasks)
    groups = {(g["options"]["regime"], g["options"]["shift"]): g for g in evaluated(tmp_path, 0.05)["groups"]}
    assert set(groups) == set(SIZES)
    for (regime, shift), group in groups.items():
        assert group["n_run"] == len(drawn)
        found = group["metrics"]
        by_env, by_run = regime in ("order", "offset"), regime in ("order", "run-order")
        # environments lie at 0, 1/4, 2/4, 3/4 and 1 of the shift, runs at what they drew; the mean of all pairs of
        # either is a half
        mean = 100 * shift / 2
        tolerance = 400 * float(np.spacing(np.float32(0.2 + 2 * shift)))
        assert found["w1_parallel"]["value"] == pytest.approx(mean * by_env, rel=0, abs=tolerance)
        assert found["w1_run_to_run"]["value"] == pytest.approx(mean * by_run, rel=0, abs=tolerance)
        assert found["distinct_envs"]["value"] == (KNOWN["n_env"] if by_env else 1)
        assert found["distinct_runs"]["value"] == (len(drawn) if by_run else 1)
        types = {(True, False): 1, (False, False): 2, (True, True): 3, (False, True): 4}
        shown = mean > 0.005  # what rounds to 0.00 cm is no type
        assert found["regime_published"]["value"] == types[shown and by_env, shown and by_run]


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is(tmp_path: Path) -> None:
    """Find no difference in 20 of 20 runs of regime identical, contacts and all: 2 processes of 10 runs each."""
    task = {"scene": "inclined-collision", "n_env": 4, "steps": 40, "warmup": 5, "timed_steps": 35, "options": {}}
    for _ in range(2):
        record_many(tmp_path, [task] * 10)
    found = evaluate(tmp_path, 0.4)
    assert found["distinct_envs"]["extra"]["per_run"] == [1] * 20
    assert found["distinct_runs"]["value"] == 1
    assert found["distinct_runs"]["n"] == 20
    assert found["w1_parallel"]["extra"]["per_run"] == [0] * 20
    assert found["w1_run_to_run"]["value"] == 0
    assert (found["capture_changes_states"]["value"], found["capture_changes_states"]["n"]) == (0, 20)
    assert found["regime_published"]["value"] == 2


@pytest.mark.slow
def test_a_capture_that_changes_states(tmp_path: Path) -> None:
    """Blame the capture for other states where runs repeat themselves, and leave open what draws anew in each build."""
    arguments = ("--n-env", 2, "--runs", 2, "--steps", 5, "--warmup", 1, "--timed-steps", 2)
    record(tmp_path, *arguments, regime="run-order", shift=0.1, contacts="off", entropy="build")
    found = evaluate(tmp_path, 0.05)
    changed = found["capture_changes_states"]
    assert changed["value"] is None
    assert "2 of 2 runs are distinct, so they may differ anyway" in changed["value_missing"]
    assert changed["extra"] == {"differ": 2, "of": 2}


@pytest.mark.slow
def test_a_run_tells_what_it_drew(tmp_path: Path) -> None:
    """Keep the drawn digits in the recording, from which the distance of two runs follows; both are of one group."""
    record(tmp_path, *FEW, "--n-env", 2, "--runs", 2, regime="run-order", shift=0.1, contacts="off")
    drawn = []
    for path in tmp_path.glob("*.mcap"):
        digits = open_recording(path).attachment("entropy.txt")
        drawn.append(fraction(digits.decode().strip()))
    found = evaluate(tmp_path, 0.05)
    assert found["w1_run_to_run"]["value"] == pytest.approx(10 * abs(drawn[0] - drawn[1]), abs=1e-5)


@pytest.mark.slow
def test_probes_find_what_is_planted() -> None:
    """Answer no to the question whose fault is planted, for each question, and yes to all where there is none."""
    command = [sys.executable, "-m", "benchmarks.probe_control", "--probes", "15", "--clean", "3"]
    done = finished(command, cwd=ROOT, timeout=600)
    assert "found: 15 of 15 planted faults" in done.stdout, done.stdout + done.stderr
    assert "blamed: 0 of 1 " in done.stdout
    assert "false: 0 of 3 probes" in done.stdout
