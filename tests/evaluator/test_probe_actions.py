"""gsb-probe where environments are given random actions, which go with them into other slots, and begin anew."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.probe.arms import arms_of
from gpusimbench.evaluator.probe.finding import Answer, Finding
from gpusimbench.evaluator.probe.pairs import Pairs, compare_pairs
from gpusimbench.evaluator.probe.questions import answers
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.location import place
from tests.conftest import call, distribution

AT, STEPS, N_ENV = 10, 30, 4
USUAL, SHIFTED = ("--initial", "random:0.1"), ("--initial", "random:0.1,shift:1")
RESET = (*USUAL, "--intervene", f"reset@{AT}")

# The engine gives every slot its own actions, whatever it was given; PLANTED is "slots", or "silent" where it does not
# tell which actions it holds. With "late", each step has the actions of the step before.
_PLUGIN = """
import os
import numpy as np
from gpusimbench.recorder.simulators.mujoco.simulator import MujocoC

class Planted(MujocoC):
    def prepare(self, actions):
        if os.environ.get("PLANTED") == "late" and len(actions) > 1:
            actions = np.concatenate([actions[:1], actions[:-1]])
        elif os.environ.get("PLANTED") and actions is not None:
            actions = self.scene.actions.draw(
                self.seed, n_env=self.n_env, first_step=self._made, n_step=len(actions)
            )
        super().prepare(actions)

    def applied(self):
        return None if os.environ.get("PLANTED") == "silent" else super().applied()
"""


@pytest.fixture(scope="module")
def plugin(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment in which a third party's distribution offers the simulator "planted"."""
    folder = tmp_path_factory.mktemp("plugin")
    return distribution(folder, "misdirected", "[gsb.simulators]\nplanted = misdirected:Planted\n", _PLUGIN)


def _recorded(folder: Path, environment: dict[str, str], *arguments: str, planted: str = "") -> Recording:
    done = call(
        "gsb-record", "--sim", "planted", "--scene", "franka", "--n-env", N_ENV, "--steps", STEPS, "--runs", 1,
        "--phases", "capture", "--no-view", *arguments, "--out", folder, env={**environment, "PLANTED": planted},
    )  # fmt: skip
    assert done.returncode == (1 if planted in ("slots", "late") else 0), done.stderr
    (path,) = done.stdout.split()
    return Recording(place(path))


@pytest.fixture(scope="module")
def sound(plugin: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Recording]:
    """Runs of an engine that does as it is told."""
    folder = tmp_path_factory.mktemp("sound")
    arms = {"plain": (), "usual": USUAL, "shifted": SHIFTED, "reset": RESET}
    return {name: _recorded(folder, plugin, *arguments) for name, arguments in arms.items()}


def _answered(recordings: dict[str, Recording]) -> dict[str, Finding]:
    (arms,) = arms_of(list(recordings.values()))
    return {finding.key: finding for finding in answers(arms)}


def test_actions_go_along(sound: dict[str, Recording]) -> None:
    """Ask about the slot and the fresh start although actions are random; not about environments that begin alike."""
    found = _answered(sound)
    # no two runs are of the same configuration here: what agrees is a yes all the same
    for key in ("slot", "bystanders", "fresh"):
        assert found[key].answer is Answer.YES, found[key]
    assert found["envs"].answer is Answer.NOT_ASKED
    assert found["envs"].reason == "the environments were given different actions, so they differ by design"
    (name,) = sound["usual"].action_names
    usual, shifted, reset = (sound[arm].actions(name) for arm in ("usual", "shifted", "reset"))
    assert np.array_equal(shifted, np.roll(usual, -1, axis=1))
    assert np.array_equal(reset[:AT], usual[:AT])
    assert np.array_equal(reset[:, 1::2], usual[:, 1::2])
    assert np.array_equal(reset[AT:, ::2], usual[: STEPS - AT, ::2])
    generators = [json.loads(sound[arm].action_streams["capture"].generator) for arm in ("usual", "shifted", "reset")]
    assert [(g.get("shift"), g.get("begun")) for g in generators] == [(None, None), (1, None), (None, [AT])]


def test_other_actions_are_not_compared(sound: dict[str, Recording]) -> None:
    """Compare no environments that were given other actions, as in recordings whose actions stayed in their slots."""
    same_slot = compare_pairs(Pairs(sound["usual"], sound["shifted"], ((0, 0),)))
    assert same_slot.reason == "the environments that would be compared were given other actions"
    later = Pairs(sound["reset"], sound["plain"], ((1, 1),), ahead=AT, first=1)  # which was not reset
    assert isinstance(compare_pairs(later), Missing)


@pytest.mark.parametrize(("arm", "arguments", "key"), [("shifted", SHIFTED, "slot"), ("reset", RESET, "fresh")])
def test_actions_that_stay_behind(
    arm: str, arguments: tuple[str, ...], key: str, sound: dict[str, Recording], plugin: dict[str, str], tmp_path: Path
) -> None:
    """Find an engine that gives environments the actions of their slots and steps, instead of those it was given."""
    wrong = _recorded(tmp_path, plugin, *arguments, planted="silent")
    recordings = {**sound, arm: wrong, "again": _recorded(tmp_path, plugin, *USUAL)}
    found = _answered(recordings)
    assert found["runs"].answer is Answer.YES
    assert {name for name, finding in found.items() if finding.answer is Answer.NO} == {key}
    difference = found[key].found
    assert difference.first_step is not None


def test_an_engine_that_tells(plugin: dict[str, str], tmp_path: Path) -> None:
    """Call a run INVALID whose engine says that it holds other actions than it was given."""
    wrong = _recorded(tmp_path, plugin, *SHIFTED, planted="slots")
    assert wrong.status == "invalid"
    assert f"the engine's actions of step {STEPS - 1} are not those it was given, in {N_ENV} envs: " in wrong.reason
    assert "they are those of the neighbouring environments" in wrong.reason
    late = _recorded(tmp_path, plugin, *USUAL, planted="late")
    assert "they are those of the step before" in late.reason


def test_shifted_actions_are_not_continued(plugin: dict[str, str], tmp_path: Path) -> None:
    """Refuse to begin at a snapshot of a run whose environments were given the actions of others."""
    made = _recorded(tmp_path, plugin, *SHIFTED, "--snapshot", str(AT))
    done = call("gsb-record", "--replay", made.path, "--from", AT, "--out", tmp_path, env=plugin, code=2)
    assert "began with --initial random:0.1,shift:1" in done.stderr
    assert "replay it without --from" in done.stderr
