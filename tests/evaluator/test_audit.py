"""gsb-audit: every level reached by real runs, and everything that keeps it from one."""

from __future__ import annotations

import json
import math
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gpusimbench import open_recording
from gpusimbench.evaluator.audit.distribution import LawTest, Unit, least_p, runs_needed, same_law
from gpusimbench.evaluator.audit.replays import ReplayPlan, closest
from gpusimbench.evaluator.audit.verdict import AuditLevel, Match, ladder
from gpusimbench.schemas.commands import SCHEMA_VERSION
from gpusimbench.schemas.provenance import SIMULATION
from tests.conftest import call, distribution, wait_for
from tests.forging import forge
from tests.synthetic import grid, write_recording
from tests.test_docs import ROOT, commands, shell

# What differs between here and there is an environment variable; MUJOCO_ is among the prefixes that recordings keep.
_PLUGIN = '''
"""MuJoCo C, but for what the environment variable MUJOCO_PLANTED says."""
import os, threading, time
import numpy as np
from gpusimbench.recorder.process.cage import most_threads
from gpusimbench.recorder.simulators.mujoco.simulator import MujocoC

def planted():
    return os.environ.get("MUJOCO_PLANTED", "nothing").partition(":")[0]

def chance():
    seed = os.environ["MUJOCO_PLANTED"].partition(":")[2]
    return np.random.default_rng(int(seed) if seed else None)

class Planted(MujocoC):
    def build(self):
        if planted() == "threads":
            for _ in range(most_threads() + 20):
                threading.Thread(target=time.sleep, args=(300,), daemon=True).start()
            time.sleep(300)
        if planted() == "no-device":
            raise RuntimeError("no CUDA-capable device is detected")
        description = super().build()
        self.fields, self.done = description.fields, 0
        shape = (self.n_env, 27, 3)
        self.shift = np.zeros(shape)
        if planted() in ("noise", "moved"):
            self.shift = chance().normal(scale=0.01, size=shape)
        if planted() == "moved":
            self.shift[..., 0] += 0.05
        if planted() in ("order", "reversed"):
            self.shift += 1e-3 * np.arange(self.n_env)[:, None, None]
        if planted() == "reversed":
            self.shift = self.shift[::-1]
        if planted() == "run":
            self.shift += chance().normal(scale=0.01)
        return description

    def spoil(self, arrays):
        out = []
        for field, array in zip(self.fields, arrays):
            array = np.array(array)
            if field.name == "cubes/position":
                array = array + self.shift
                if planted() == "ulp":
                    array[..., -1, 5, 0] = np.nextafter(array[..., -1, 5, 0], np.inf)
            out.append(array)
        return tuple(out)

    def state(self):
        return self.spoil(super().state())

    def states(self, n_step):
        if planted() == "slow":
            time.sleep(300)
        return self.spoil(super().states(n_step))

    def gates(self):
        return ["contacts were dropped"] if planted() == "invalid" else []
'''


@pytest.fixture(scope="module")
def plugin(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment in which a third party's distribution offers the simulator "planted"."""
    folder = tmp_path_factory.mktemp("plugin")
    return distribution(folder, "planted-simulator", "[gsb.simulators]\nplanted = planted_simulator:Planted\n", _PLUGIN)


_SHORT = ("--n-env", "4", "--steps", "5", "--phases", "capture")


def _recorded(folder: Path, environment: dict[str, str], *arguments: object, planted: str = "nothing") -> list[Path]:
    given = ("--sim", "planted", *_SHORT, "--runs", "1", *arguments, "--out", folder)
    done = call("gsb-record", *given, env={**environment, "MUJOCO_PLANTED": planted}, code=0)
    return [Path(line) for line in done.stdout.split()]


def _audit(
    *arguments: object, environment: dict[str, str] | None = None, planted: str = "nothing", **keywords: Any
) -> subprocess.CompletedProcess[str]:
    env = {**(environment or dict(os.environ)), "MUJOCO_PLANTED": planted}
    return call("gsb-audit", *arguments, env=env, **keywords)


def _one(done: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    document = json.loads(done.stdout)
    assert document["schema_version"] == SCHEMA_VERSION
    (audit,) = document["audits"]
    return audit


def _rung(audit: dict[str, Any], level: str) -> dict[str, Any]:
    (found,) = (rung for rung in audit["rungs"] if rung["level"] == level)
    return found


def test_the_same_comes_out_on_the_same_machine(small_set: list[Path], tmp_path: Path) -> None:
    """Find MuJoCo C bit-identical here, for the whole of a set, and say what was run and where it is."""
    done = _audit(*small_set, cwd=tmp_path, code=0)
    lines = done.stdout.splitlines()
    verdict = f"Re-execution gives the same bits (bit-identical): {small_set[0].name} and 2 more of its set"
    assert " ".join(done.stdout.split()).startswith(verdict)
    assert len(lines) <= 16
    counted = "  runs               3 originals, 1 distinct by state hashes; 1 replay, 1 distinct; 1 distinct together"
    assert counted in lines
    assert f"gsb-record --replay {small_set[0]} --runs 1 --out audit" in done.stdout
    (replay,) = (tmp_path / "audit").glob("*.mcap")
    assert f"  replays            complete: {replay.relative_to(tmp_path)}" in lines
    of = open_recording(replay).provenance.replay_of
    assert of.content_hash == open_recording(small_set[0]).content_hash
    assert "replay of run" in done.stderr


def test_another_option_is_found_and_named(small: Path, tmp_path: Path) -> None:
    """Replay a forged copy that claims another friction cone than it ran with: different, and where it begins."""

    def claim(document: dict[str, Any]) -> None:
        document["configuration"]["options"]["cone"] = "pyramidal"

    forged = forge(small, tmp_path / "forged.mcap", claim)
    done = _audit(forged, "--out", tmp_path / "out", "--require", "bit-identical", "--all", code=4)
    assert "  [ ] bit-identical         0 of 1 replays agree with an original in every bit" in done.stdout
    assert "  differs                   from step " in done.stdout
    assert re.search(r"^engine\.cone +elliptic +pyramidal", done.stdout, re.MULTILINE)


_REACHED = {
    ("nothing", "nothing"): ("bit-identical", 0),
    ("order", "reversed"): ("same-up-to-env-order", 0),
    ("nothing", "ulp"): ("within-ulps", 0),
    ("noise:1", "noise:2"): ("same-distribution", 0),
    ("noise:1", "moved:2"): ("different", 4),
    ("run", "run"): (None, 5),
    ("nothing", "invalid"): ("different", 4),
    ("nothing", "no-device"): (None, 5),
}


_QUICK = (("nothing", "ulp"), ("noise:1", "noise:2"), ("nothing", "no-device"))


@pytest.mark.parametrize(
    ("there", "here"),
    [pair if pair in _QUICK else pytest.param(*pair, marks=pytest.mark.slow) for pair in _REACHED],
)
def test_every_level_is_reached(there: str, here: str, plugin: dict[str, str], tmp_path: Path) -> None:
    """Reach each rung of the ladder with runs that differ by a known thing."""
    (original,) = _recorded(tmp_path, plugin, planted=there)
    done = _audit(original, "--out", tmp_path / "here", "--json", "-", environment=plugin, planted=here)
    audit = _one(done)
    assert (audit["level"], done.returncode) == _REACHED[there, here], done.stdout + done.stderr
    if here == "ulp":
        assert audit["difference"]["max_ulp"] == 1
        number = audit["difference"]["first"]["state"]["number"]
        assert (number["field"], number["ulp"], number["component"]) == ("cubes/position", 1, "x")
        assert audit["difference"]["first"]["step_a"] == 0
    if here == "no-device":
        assert "no CUDA-capable device is detected" in audit["level_missing"]
    if here == "run":
        # every environment of a run has the same bits, so that a run is one draw
        assert audit["law"]["unit"] == "runs"
        assert "give --runs 19 (about " in _rung(audit, "same-distribution")["said"]
    if there != here and audit["settings"]:
        planted = next(s for s in audit["settings"] if s["name"] == "environment.MUJOCO_PLANTED")
        assert (planted["a"], planted["b"]) == (there, here)


def test_a_stricter_requirement_fails(plugin: dict[str, str], tmp_path: Path) -> None:
    """Fail the gate where what is required is refuted, though nothing weaker could be decided."""
    (original,) = _recorded(tmp_path, plugin)
    given = (original, "--out", tmp_path / "here", "--require", "within-ulps", "--ulps", "0")
    done = _audit(*given, environment=plugin, planted="ulp", code=4)
    assert done.stdout.startswith("Re-execution gives other bits; undecided whether of the same distribution:")
    assert "largest distance 1 ULP over 6 recorded steps; 0 are allowed" in done.stdout


@pytest.mark.slow
def test_runs_are_exchanged_where_there_are_enough(plugin: dict[str, str], tmp_path: Path) -> None:
    """Use all originals of a set: three and four runs are enough to exchange runs, and to find the same law."""
    originals = _recorded(tmp_path, plugin, "--runs", "3", planted="run")
    given = (*originals, "--runs", "4", "--out", tmp_path / "here", "--json", "-")
    audit = _one(_audit(*given, environment=plugin, planted="run"))
    law = audit["law"]
    assert (law["unit"], law["originals"], law["replays"]) == ("runs", 3, 4)
    assert math.isclose(law["least_p"], 1 / 35)
    # chance draws the runs: which of the two it is depends on p, and p alone
    assert audit["level"] == ("different" if law["p_value"] <= 0.05 else "same-distribution")


def test_what_cannot_be_replayed_here(small: Path, tmp_path: Path) -> None:
    """Say what is missing and how to get it, with an exit code of its own, where the engine is not here."""

    def elsewhere(document: dict[str, Any]) -> None:
        document["configuration"]["simulator"] = "unheard-of"

    done = _audit(forge(small, tmp_path / "forged.mcap", elsewhere), "--out", tmp_path, code=5)
    assert done.stdout.startswith("No verdict: the replay was refused: forged.mcap\n")
    assert "known: mujoco" in done.stdout
    assert "there is no simulator 'unheard-of'; known: mujoco" in " ".join(done.stdout.split())


def test_a_replay_that_takes_too_much_is_stopped(plugin: dict[str, str], tmp_path: Path) -> None:
    """Say which bound a replay passed, end with 5, keep nothing of it, and try no second time."""
    (original,) = _recorded(tmp_path, plugin)
    out = tmp_path / "here"
    done = _audit(original, "--runs", 3, "--out", out, "--json", tmp_path / "a.json", environment=plugin,
                  planted="threads", code=5)  # fmt: skip
    assert done.stdout.startswith(f"No verdict: the replay was stopped: {original.name}\n")
    assert "stopped: threads: it had " in done.stdout
    (audit,) = json.loads((tmp_path / "a.json").read_text())["audits"]
    assert (audit["outcome"], audit["level"], audit["meets_requirement"]) == ("stopped", None, None)
    (replay,) = audit["replays"]
    assert (replay["status"], replay["file"]) == ("stopped", None)
    assert not list(out.iterdir())


def test_a_broken_rule_fails(tmp_path: Path) -> None:
    """Fail where a file is whole but does not say where it comes from, whatever a replay may say."""
    done = _audit(write_recording(tmp_path, grid(2)), "--out", tmp_path / "here", code=4)
    assert "; the file breaks integrity-1: " in done.stdout.splitlines()[0]
    assert re.search(r"^  check +integrity-1 is broken\n +provenance: ", done.stdout, re.MULTILINE)


def test_damaged_files_are_named_and_others_audited(small: Path, tmp_path: Path) -> None:
    """End with the code of damage, after the good files were audited all the same."""
    bytes_of = bytearray(small.read_bytes())
    bytes_of[len(bytes_of) // 2] ^= 1
    (tmp_path / "bad.mcap").write_bytes(bytes_of)
    (tmp_path / "cut.mcap").write_bytes(bytes(bytes_of[: len(bytes_of) // 3]))
    done = _audit(small, tmp_path / "bad.mcap", tmp_path / "cut.mcap", "--out", tmp_path / "here", "--json", "-")
    assert done.returncode == 3
    document = json.loads(done.stdout)
    assert [Path(d["file"]).name for d in document["damaged"]] == ["bad.mcap", "cut.mcap"]
    assert [audit["level"] for audit in document["audits"]] == ["bit-identical"]
    assert "bad.mcap is not audited: " in done.stderr


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("--runs", "0"), "--runs"),
        (("--ulps", "-1"), "--ulps"),
        (("--timeout", "nan"), "--timeout"),
        (("--json", "x.mcap"), "--json"),
    ],
)
def test_arguments_that_cannot_be(small: Path, given: tuple[str, str], said: str) -> None:
    """Refuse arguments that make no audit, before anything is run."""
    done = _audit(small, *given, code=2)
    assert said in done.stderr


def _law(p: float, least: float) -> LawTest:
    return LawTest(5.0, Unit.RUNS, 3, 3, 4, 4, 1.0, 2.0, p, least, 199, False, 0)


def _possible() -> Iterator[tuple[Match, LawTest | str]]:
    laws = (_law(0.5, 0.01), _law(0.01, 0.01), _law(0.5, 0.5), "no positions")
    for bits, order, ulp, law in product((True, False), (True, False, None), (None, 0, 3, 10**6), laws):
        yield Match(bits, order, ulp), law


@pytest.mark.parametrize(("match", "law"), list(_possible()))
def test_the_verdict_is_the_strongest_that_holds(match: Match, law: LawTest | str) -> None:
    """Keep the ladder's own order: nothing above the verdict holds, everything below follows."""
    verdict = ladder([match], lambda: law, max_ulps=4, originals=1)
    holds = {rung.level: rung.holds for rung in verdict.rungs}
    assert list(holds) == list(AuditLevel)[:4]
    if verdict.level is AuditLevel.DIFFERENT:
        assert holds[AuditLevel.SAME_DISTRIBUTION] is False
        assert True not in holds.values()
    elif verdict.level is None:
        assert holds[AuditLevel.SAME_DISTRIBUTION] is None
        assert True not in holds.values()
    else:
        held = [level for level, held in holds.items() if held]
        assert held == [level for level in holds if verdict.level.reaches(level)]
    assert (verdict.level is AuditLevel.BIT_IDENTICAL) == match.bit_identical
    for required in list(AuditLevel)[:4]:
        held = [holds[level] for level in holds if level.reaches(required)]
        assert verdict.meets(required) is (True if True in held else None if None in held else False)


def test_all_replays_count() -> None:
    """Hold no level that one replay does not reach."""
    same, near, reversed_ = Match(True, True, 0), Match(False, False, 2), Match(False, True, 10**9)
    levels = [
        ladder(list(matches), lambda: "none", max_ulps=4, originals=1).level
        for matches in ((same, same), (same, near), (same, reversed_), (near, reversed_), (near, Match(False, None, 9)))
    ]
    assert levels == [
        AuditLevel.BIT_IDENTICAL, AuditLevel.WITHIN_ULPS, AuditLevel.SAME_UP_TO_ENV_ORDER, AuditLevel.WITHIN_ULPS, None
    ]  # fmt: skip


@settings(max_examples=30)
@given(a=st.integers(1, 12), b=st.integers(1, 12))
def test_least_p_counts_arrangements(a: int, b: int) -> None:
    """Give the share of one arrangement among all, two among equal sides; exchange of the sides changes nothing."""
    arrangements = math.comb(a + b, a) / (2 if a == b else 1)
    assert math.isclose(least_p(a, b), 1 / arrangements if arrangements <= 400 else 1 / 200)
    assert least_p(a, b) == least_p(b, a)


@pytest.mark.parametrize(("originals", "needed"), [(1, 19), (2, 5), (3, 4), (10, 2)])
def test_runs_needed(originals: int, needed: int) -> None:
    """Name the fewest replays that can decide, no fewer."""
    assert runs_needed(originals) == needed
    assert least_p(originals, needed) <= 0.05
    assert needed == 1 or least_p(originals, needed - 1) > 0.05


@pytest.mark.parametrize("originals", [*range(1, 25), 60, 450])
def test_so_many_runs_do_reject(originals: int) -> None:
    """Tell sides that are far apart from each other with the replays that are named as needed, whatever is drawn."""
    rng, needed = np.random.default_rng(originals), runs_needed(originals)
    sides = (
        [_drawn(rng, envs=1, moved=5.0 * side)[:, :2] for _ in range(n)] for side, n in enumerate((originals, needed))
    )
    found = same_law(*sides, time=5.0)
    assert (found.unit, found.can_reject, found.rejects) == (Unit.RUNS, True, True)
    assert found.exhaustive == (originals < 400)
    if found.exhaustive:
        assert found.p_value == found.least_p
    # and copies on both sides change nothing
    copies = same_law([np.zeros((1, 2, 2))] * originals, [np.ones((1, 2, 2))] * needed, time=5.0)
    assert copies.rejects


def test_environments_are_exchanged_with_a_warning() -> None:
    """Say what an exchange of environments cannot see, and what would."""
    rng = np.random.default_rng(4)
    law = same_law([_drawn(rng)], [_drawn(rng)], time=5.0)
    said = ladder([Match(False, False, None)], lambda: law, max_ulps=4, originals=1).rungs[-1].said
    assert "without power if results depend on the number of an environment: --runs 19 would exchange runs" in said
    said = ladder([Match(False, False, None)], lambda: law, max_ulps=4, originals=1, each_s=64.0).rungs[-1].said
    assert said.endswith(
        "environment: --runs 19 (about 20 min 16 s on this machine) would exchange runs; not rejected at 0.05"
    )


@pytest.mark.parametrize(("ran", "limit"), [(0.5, 600), (40.01, 801), (1e9, 86_400)])
def test_replays_have_a_time_limit(ran: float, limit: float) -> None:
    """Bound what a file can ask for by what its run took, within ten minutes and a day, unless the user says."""
    plan = ReplayPlan(Path("out"))
    assert plan.within(ran).timeout == limit
    assert f"--timeout {limit}" in " ".join(plan.within(ran).arguments(Path("a.mcap")))
    assert replace(plan, timeout=0.0).within(ran).timeout == 0


def test_what_was_not_compared_is_not_the_same() -> None:
    """Decide no level for less than the original, but refute one by what was compared."""
    part = Match(True, True, 0, left_out="the capture phase")
    verdict = ladder([part, Match(True, True, 0)], lambda: "none", max_ulps=4, originals=1)
    assert [rung.holds for rung in verdict.rungs] == [None] * 4
    assert verdict.rungs[0].said.endswith("not everything of the original was compared: the capture phase")
    far = Match(False, False, 10, left_out="a field", no_ulps="a field cannot be compared by bits")
    assert [r.holds for r in ladder([far], lambda: "none", max_ulps=4, originals=1).rungs[:3]] == [False] * 3
    assert ladder([replace(far, max_ulp=1)], lambda: "none", max_ulps=4, originals=1).rungs[2].holds is None


@pytest.mark.slow
def test_a_part_of_a_recording_is_said_to_be_one(tmp_path_factory: pytest.TempPathFactory, tmp_path: Path) -> None:
    """Replay the timed phase alone and a forged copy with origins: not bit-identical; refuse one with other names."""
    folder = tmp_path_factory.mktemp("whole")
    given = ("--n-env", "2", "--runs", "1", "--steps", "6", "--warmup", "3", "--timed-steps", "4")
    # without a view, which a forger of names and origins would have to forge, too
    assert call("gsb-record", "--sim", "mujoco", "--no-view", *given, "--out", folder).returncode == 0
    (whole,) = folder.glob("*.mcap")
    done = _audit(whole, "--phases", "timed", "--out", tmp_path / "timed", code=5)
    said = " ".join(done.stdout.split())
    assert "1 of 1 replays agree with an original in the 2 state hashes of the timed phase; not everything" in said
    assert "1 original, 1 distinct by state hashes; 1 replay, 1 distinct; 1 distinct together" in done.stdout

    def renamed(document: dict[str, Any]) -> None:
        for field in document["fields"][1:]:
            field["items"] = [f"{name}'" for name in field["items"]]

    def elsewhere(document: dict[str, Any]) -> None:
        document["env_origins"] = [[1.0, 0.0, 0.0]] * 2

    names = forge(whole, tmp_path / "names.mcap", renamed, attachment=SIMULATION)
    refused = _audit(names, "--out", tmp_path / "out", code=3)
    assert "simulation.json disagree on items" in refused.stderr
    origins = forge(whole, tmp_path / "origins.mcap", elsewhere, attachment=SIMULATION)
    audit = _one(_audit(origins, "--out", tmp_path / "out", "--json", "-"))
    assert (audit["level"], audit["meets_requirement"]) == (None, None)
    assert (_rung(audit, "bit-identical")["holds"], _rung(audit, "within-ulps")["holds"]) == (False, None)


@pytest.mark.slow
def test_two_originals_and_five_replays_are_enough(small_set: list[Path], tmp_path: Path) -> None:
    """Call another friction cone different with as many replays as the command asks for."""
    done = _audit(*small_set[:2], "--runs", "5", "--option", "cone=pyramidal", "--out", tmp_path, "--json", "-")
    audit = _one(done)
    assert (audit["level"], done.returncode) == ("different", 4), done.stderr
    assert (audit["law"]["n_permutation"], audit["law"]["exhaustive"]) == (21, True)


def _drawn(rng: np.random.Generator, *, envs: int = 8, moved: float = 0.0) -> Any:
    return rng.normal(scale=0.01, size=(envs, 5, 2)) + moved


def test_environments_are_exchanged_where_each_is_a_draw() -> None:
    """Tell a moved law from the same one with one run a side, by environments."""
    rng = np.random.default_rng(1)
    same = same_law([_drawn(rng)], [_drawn(rng)], time=5.0)
    assert same.unit is Unit.ENVIRONMENTS
    assert (same.rejects, same.can_reject) == (False, True)
    assert same_law([_drawn(rng)], [_drawn(rng, moved=0.02)], time=5.0).rejects


def test_copies_are_one_draw() -> None:
    """Exchange no environments that are copies of each other, or that their number decides: all would be rejected."""
    rng = np.random.default_rng(2)
    copies = [np.repeat(_drawn(rng, envs=1), 8, axis=0) for _ in range(2)]
    found = same_law(copies[:1], copies[1:], time=5.0)
    assert (found.unit, found.can_reject, found.rejects) == (Unit.RUNS, False, False)
    fixed = _drawn(rng)
    numbered = same_law([fixed, fixed], [_drawn(rng)], time=5.0)
    assert numbered.unit is Unit.RUNS
    assert not numbered.can_reject


@pytest.mark.slow
def test_large_runs_are_drawn_from() -> None:
    """Test some environments of many, the same ones on both sides, and say how many."""
    rng = np.random.default_rng(3)
    found = same_law([_drawn(rng, envs=500)], [_drawn(rng, envs=500)], time=5.0)
    assert (found.envs_per_run, found.envs, found.originals) == (86, 500, 86)


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_an_interruption_ends_the_replay(number: signal.Signals, plugin: dict[str, str], tmp_path: Path) -> None:
    """Pass an interruption on: the replay's recording gets its end, and nothing goes on behind."""
    (original,) = _recorded(tmp_path, plugin)
    command = [sys.executable, "-P", "-m", "gpusimbench.evaluator.cli.audit", original, "--out", tmp_path / "here"]
    environment = {**plugin, "MUJOCO_PLANTED": "slow"}
    audit = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
    wait_for(lambda: any(path.stat().st_size > 0 for path in (tmp_path / "here").glob("*.partial")))
    audit.send_signal(number)
    _, said = audit.communicate(timeout=300)
    assert audit.returncode == 1
    assert said.endswith("gsb-audit: interrupted\n")
    (replay,) = (tmp_path / "here").iterdir()
    ended = open_recording(replay)
    assert ended.status == "failed"
    assert ended.reason.startswith("interrupted in phase ")


@pytest.mark.slow
def test_the_commands_of_the_page(tmp_path: Path) -> None:
    """Run what docs/audit.md shows on the sample recordings: those of another machine come out bit for bit."""
    lines = commands(ROOT / "docs" / "audit.md")
    assert len(lines) == 2
    (tmp_path / "recordings").symlink_to(ROOT / "recordings")
    for line in lines:
        own = line.replace("gsb-audit", f"{sys.executable} -P -m gpusimbench.evaluator.cli.audit")
        assert shell(own, tmp_path).stdout


def test_the_closest_original(tmp_path: Path) -> None:
    """Hold a replay against the original that has its very states, before one whose environments are exchanged."""
    final = grid(2)
    final[1] += 0.01
    exchanged, same, other, replay = (
        open_recording(write_recording(tmp_path, states, name=f"{name}.mcap"))
        for name, states in (("a", final[::-1]), ("b", final), ("c", final + 1.0), ("d", final))
    )
    assert closest(replay, [other, exchanged, same]) is same
    assert closest(replay, [other, exchanged]) is exchanged
    assert closest(other, [exchanged, same]) is exchanged
