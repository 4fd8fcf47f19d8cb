"""Recordings whose environments differ in their parameters: what every command makes of them."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench import open_recording
from gpusimbench.evaluator.inputs.reader import read_run
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.probe.arms import arms_of
from gpusimbench.evaluator.probe.finding import Answer
from gpusimbench.evaluator.probe.questions import probed
from gpusimbench.evaluator.probe.runs import Arm, Plan, arm_of
from gpusimbench.evaluator.read.described import factors_of
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.results.identity_metrics import comparable
from gpusimbench.evaluator.runs.groups import key_of
from gpusimbench.evaluator.runs.physics.facts import Check
from gpusimbench.evaluator.runs.physics.measure import physics_of
from gpusimbench.schemas import arrays
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.location import place
from tests.conftest import Command, call, distribution
from tests.forging import forge

ROOT = Path(__file__).resolve().parents[2]
VARY = "mass:0.3,friction:0.3"
_SHORT = ("--sim", "mujoco", "--steps", "60", "--warmup", "10", "--timed-steps", "50", "--no-view")


@pytest.fixture(scope="module")
def varied(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ...]:
    """Two runs of four environments of MuJoCo C whose parameters differ, and one of the scene's."""
    folder = tmp_path_factory.mktemp("varied")
    found: list[Path] = []
    for runs, arguments in ((2, ("--vary", VARY)), (1, ())):
        done = call("gsb-record", *_SHORT, "--n-env", "4", "--runs", str(runs), *arguments, "--out", folder, code=0)
        found += map(Path, done.stdout.split())
    return tuple(found)  # the first two are of a group


def test_read(varied: tuple[Path, ...]) -> None:
    """Give the factors of each environment by quantity, and none where there are none."""
    found = open_recording(varied[0]).varied
    assert list(found) == ["mass", "friction"]
    assert found["mass"].items[0] == "ball"
    assert found["mass"].values.shape == (4, 28)
    assert 0 < np.abs(found["mass"].values - 1).max() <= 0.3
    assert open_recording(varied[2]).varied == {}


def _changed(**arrays_: np.ndarray | None) -> bytes:
    items = np.array(["a", "b"])
    whole = {"mass": np.ones((2, 2)), "mass/items": items, **arrays_}
    return arrays.encode({name: array for name, array in whole.items() if array is not None})


@pytest.mark.parametrize(
    ("attached", "why"),
    [
        (None, "is not there"),
        (b"no archive", "is no archive of arrays"),
        (_changed(mass=None), "has no factors of mass"),
        (_changed(mass=np.ones((2, 2), dtype=int)), "has no factors of mass"),
        (_changed(**{"mass/items": np.array([1, 2])}), "has no factors of mass"),
        (_changed(mass=np.ones((3, 2))), r"of the shape \(3, 2\), not of 2 environments and 2 items"),
        (_changed(mass=np.full((2, 2), 1.2)), r"not within 1 \+- 0\.1"),
        (_changed(mass=np.full((2, 2), np.nan)), r"not within 1 \+- 0\.1"),
    ],
    ids=range(8),
)  # fmt: skip
def test_damaged(attached: bytes | None, why: str) -> None:
    """Call a recording damaged whose factors are not those that it was asked for."""
    configuration = RunConfiguration("mujoco", "free-fall", 2, 0.01, 4, vary="mass:0.1")
    assert factors_of(configuration, _changed())["mass"].items == ("a", "b")
    assert factors_of(replace(configuration, vary=""), None) == {}
    with pytest.raises(DamagedRecording, match=why):
        factors_of(configuration, attached)


def test_checked(varied: tuple[Path, ...], tmp_path: Path) -> None:
    """Find nothing wrong, and that factors are not those that a changed configuration asks for; do not replay these."""
    assert call("gsb-check", varied[0]).returncode == 0
    for text, why in (("mass:0.1,friction:0.3", "not within 1 +- 0.1"), ("mass:0.3,size:0.1", "no factors of size")):

        def change(document: dict[str, Any], text: str = text) -> None:
            document["configuration"]["vary"] = text

        forged = forge(varied[0], tmp_path / f"{text[:8]}.mcap", change)
        done = call("gsb-check", forged, code=4)
        assert why in " ".join(done.stdout.split())
        replayed = call("gsb-record", "--replay", forged, "--out", tmp_path, code=2)
        assert "draws other parameters here than it has" in replayed.stderr


def test_groups(varied: tuple[Path, ...]) -> None:
    """Keep runs apart whose parameters are others; compare the bits of no two of them."""
    one, other, plain = (Recording(place(str(path))) for path in varied)
    assert key_of(one) == key_of(other)
    assert key_of(one).told["vary"] == VARY
    assert key_of(one).with_settings(vary="") == key_of(plain)
    runs = [read_run(Recording(place(str(path))), 0.6) for path in varied]
    assert comparable(runs[0]) == comparable(runs[1]) != comparable(runs[2])


def test_evaluated(varied: tuple[Path, ...], gsb_eval: Command) -> None:
    """Compare runs, and not environments, which are meant to differ."""
    done = gsb_eval(*varied[:2], "--json", "-", code=0)
    (group,) = json.loads(done.stdout)["groups"]
    assert group["vary"] == VARY
    assert group["metrics"]["distinct_runs"]["value"] == 1
    assert group["metrics"]["distinct_envs"]["value_missing"] == f"environments differ by --vary {VARY}"
    assert "not compared: environments differ by --vary" in " ".join(gsb_eval(*varied[:2]).stdout.split())


def test_mechanics(varied: tuple[Path, ...]) -> None:
    """Hold no state against the scene's masses where environments have others; see that all are finite."""
    facts = physics_of(Recording(place(str(varied[0])))).facts
    assert not isinstance(facts, Missing)
    assert [check for check, fact in facts.items() if not isinstance(fact, Missing)] == [Check.FINITE, Check.SANK]
    reason = facts[Check.ENERGY_START]
    assert "other parameters than the scene" in reason.reason


def test_told(varied: tuple[Path, ...]) -> None:
    """Say what varies."""
    assert f"vary         {VARY}: factors of each environment, in varied.npz" in call("gsb-info", varied[0]).stdout
    assert "\n  vary " not in call("gsb-info", varied[2]).stdout


def test_the_arms_of_a_plan() -> None:
    """Ask for parameters that go with the initial states: in the same slots, others of the same neighbours."""
    plan = Plan("mujoco", "inclined-collision", "default", (), 0, 60, 4, (2,), 0.1, vary=VARY)
    for arm in plan.arms():
        if arm.continued:
            continue
        given = plan.arguments(arm, "out")
        tail = arm.initial.removeprefix("random:0.1")
        tail = "" if "mirror" in tail or "relabel" in tail else tail  # an environment keeps its parameters
        assert given[given.index("--vary") + 1] == VARY + tail
        c = RunConfiguration(
            "mujoco", "inclined-collision", arm.n_env, 0.01, 60, initial=arm.initial, intervention=arm.intervention,
            phases=("timed", "capture") if arm.timed else ("capture",), vary=VARY + tail,
            snapshots=(arm.snapshot,) if arm.snapshot else (),
        )  # fmt: skip
        assert arm_of(c) == arm
        assert plan.has(c)
        assert not plan.has(replace(c, vary=""))
        assert not plan.has(replace(c, vary=f"{VARY},shift:3"))
    without = replace(plan, vary="")
    assert "--vary" not in without.arguments(Arm(4), "out")


@pytest.fixture(scope="module")
def arms(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A probe of MuJoCo C whose environments differ in their parameters."""
    folder = tmp_path_factory.mktemp("probe")
    call(
        "gsb-probe", "--sim", "mujoco", "--n-env", "4", "--numbers", "2", "--steps", "30", "--vary", VARY, "--out",
        folder, "--json", folder / "answers.json", code=0,
    )  # fmt: skip
    return folder


@pytest.mark.slow
def test_probed(arms: Path) -> None:
    """Answer what can be asked of environments that differ in their parameters, and say what cannot."""
    (probe,) = json.loads((arms / "answers.json").read_text())["probes"]
    answers = {answer["key"]: answer for answer in probe["answers"]}
    assert probe["vary"] == VARY
    assert answers["envs"]["answer"] == Answer.NOT_ASKED
    assert answers["envs"]["reason"] == f"environments differ by --vary {VARY}"
    for key in (
        "runs",
        "capture",
        "number",
        "slot",
        "neighbours",
        "poison",
        "bystanders",
        "fresh",
        "restored",
        "process",
    ):
        assert answers[key]["answer"] == Answer.YES, answers[key]
    assert answers["slot"]["compared"] == "the same initial states and parameters, 1 slots further"


@pytest.mark.slow
def test_arms_of_files(arms: Path) -> None:
    """Hold an environment in another slot against itself by parameters, and not against who stood there before."""
    files = sorted(arms.glob("*.mcap"))
    (found,) = arms_of([Recording(place(str(path))) for path in files])
    assert found.key.told["vary"] == VARY
    assert found.varied
    otherwise = {initial.kind: run for run, initial in found.otherwise.items()}
    shifted, usual = otherwise["shift"].varied["mass"].values, found.varied[0].varied["mass"].values
    assert np.array_equal(shifted, np.roll(usual, -1, axis=0))
    but = otherwise["but"]
    assert (but.varied["mass"].values == usual).all(axis=1).tolist() == [True, False, False, False]


@pytest.mark.slow
def test_parameters_that_stay_behind(arms: Path, tmp_path: Path) -> None:
    """Take no run for an arm whose initial states change slots while its parameters stay."""
    done = call(
        "gsb-record", "--sim", "mujoco", "--n-env", "4", "--steps", "30", "--runs", "1", "--phases", "capture",
        "--initial", "random:0.1,shift:1", "--vary", VARY, "--out", tmp_path, code=0,
    )  # fmt: skip
    alone = Recording(place(done.stdout.strip()))
    assert arms_of([alone]) == []
    together = probed([alone, *(Recording(place(str(path))) for path in sorted(arms.glob("*.mcap")))])
    assert [finding.answer for one in together for finding in one.findings if finding.key == "slot"] == [Answer.YES]


def test_a_simulator_that_cannot(gsb_probe: Command, tmp_path: Path) -> None:
    """Say which ability is missing, and probe nothing."""
    done = gsb_probe("--sim", "genesis", "--quick", "--vary", "mass:0.1", "--out", tmp_path, code=2)
    assert "it has no masses per environment" in done.stderr


@pytest.mark.parametrize("text", ["mass", "mass:0.1,shift:1", "colour:0.1"])
def test_no_parameters(text: str, gsb_probe: Command) -> None:
    """Refuse what says nothing that can vary; slots are the probe's own."""
    done = gsb_probe("--sim", "mujoco", "--vary", text, code=2)
    assert "--vary takes mass:SPREAD, friction:SPREAD, size:SPREAD" in done.stderr


@pytest.mark.slow
def test_a_mix_up_of_parameters_is_found(gsb_probe: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Find that all environments have the masses of the first one, which shows where environments change slots."""
    distribution(
        tmp_path, "broken", "[gsb.simulators]\nfirst-masses = tests.recorder.broken_adapters:FirstEnvsMasses\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(map(str, (tmp_path, ROOT, ROOT / "src"))))
    target = tmp_path / "answers.json"
    gsb_probe(
        "--sim", "first-masses", "--n-env", "4", "--numbers", "2", "--steps", "150", "--stride", "50",
        "--vary", "mass:0.3", "--out", tmp_path / "arms", "--json", target, code=0,
    )  # fmt: skip
    (probe,) = json.loads(target.read_text())["probes"]
    found = {one["key"] for one in probe["answers"] if one["answer"] == Answer.NO}
    assert found - {"mirrored", "relabelled", "set"} == {"slot"}  # the others are MuJoCo C's own
