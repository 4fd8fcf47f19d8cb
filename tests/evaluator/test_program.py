"""Two runs of one program: what differs first is found where it was planted, and named with what was the same."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench import open_recording
from gpusimbench.evaluator.diff.brief import verdict_of
from gpusimbench.evaluator.diff.compare import compare
from gpusimbench.evaluator.diff.program_parts import ComparedPart, Kind
from gpusimbench.evaluator.diff.result import Difference, DiffVerdict
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.recorder.capture.array_hashes import ArrayHashWriter, Hashed
from gpusimbench.recorder.log import RecordingWriter
from gpusimbench.schemas.errors import DamagedRecording, ExitCode
from gpusimbench.schemas.fields import array_field
from tests.conftest import call

UPDATES, STEPS = 3, 4  # steps an update
Plant = Callable[[str, int, np.ndarray], np.ndarray]


def nothing(what: str, at: int, value: np.ndarray) -> np.ndarray:
    """Plant no difference."""
    return value


def planted(name: str, number: int) -> Plant:
    """Change the last bit of the number-th value of that name."""
    return lambda what, at, value: np.nextafter(value, 9) if (what, at) == (name, number) else value


def train(path: Path, plant: Plant = nothing, *, updates: int = UPDATES, extra: int = 0, **others: Any) -> Recording:
    """A linear policy that is updated from what a toy simulator returns; `plant` changes values on the way."""
    fields = (array_field("action", "float64"), array_field("observation", "float64"))
    policy, seen, step = np.full(3, 0.1), np.array([0.5, 0.7]), 0
    given = {"simulator": "mine", "version": "1", "scene": "toy", "n_env": 2, "dt": 0.5, "steps": updates * STEPS}
    with RecordingWriter(path, **{**given, **others}, fields=fields) as log:
        policy = plant("policy", 0, policy)
        log.fingerprint("policy", {"w": policy, "b": np.zeros(2)})
        log.append(np.zeros(2), seen)
        for update in range(updates):
            rows = []
            for _ in range(STEPS):
                step += 1
                action = plant("action", step, seen * policy.mean())
                seen = plant("observation", step, np.sin(seen + action))
                log.append(action, seen)
                rows.append(seen)
            batch = plant("batch", update, np.array(rows))
            log.fingerprint("batch", batch)
            gradient = plant("gradient", update, batch.sum(axis=1)[:3])
            log.fingerprint("gradient", gradient)
            policy = policy + 0.01 * gradient
            log.fingerprint("policy", {"w": policy, "b": np.zeros(2)})
        for _ in range(extra):
            log.fingerprint("policy", policy)
    return open_recording(path)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A run in which nothing is planted."""
    return train(tmp_path_factory.mktemp("plain") / "a.mcap")


def beside(plain: Recording, folder: Path, plant: Plant, **others: Any) -> Difference:
    """The comparison of a run with one in which a difference was planted."""
    return compare(plain, train(folder / "b.mcap", plant, **others))


def first_of(found: Difference) -> ComparedPart:
    """The part that differs first."""
    assert found.program.first is not None
    assert found.verdict is DiffVerdict.DIFFERENT
    assert not found.bit_identical
    return found.program.first


def test_equal_runs_are_equal(plain: Recording, tmp_path: Path) -> None:
    """Compare every part, and find nothing."""
    found = beside(plain, tmp_path, nothing)
    assert found.bit_identical
    assert {part.name for part in found.program.parts} == {
        "policy", "batch", "gradient", "env/action", "env/observation",
    }  # fmt: skip
    assert [part.first for part in found.program.parts] == [None] * 5


@pytest.mark.parametrize(
    ("name", "at", "update", "same", "last"),
    [
        ("policy", 0, 0, set(), ""),
        ("batch", 1, 1, {"policy", "batch", "gradient", "env/action", "env/observation"}, "the states of step 8"),
        ("gradient", 0, 0, {"policy", "batch", "env/action", "env/observation"}, "batch at update 0"),
        ("gradient", 2, 2, {"policy", "batch", "gradient", "env/action", "env/observation"}, "batch at update 2"),
    ],
)
def test_an_array_that_differs_first_is_named(
    plain: Recording, tmp_path: Path, name: str, at: int, update: int, same: set[str], last: str
) -> None:
    """Plant one bit in an array: the update is named, and what was the same before."""
    found = beside(plain, tmp_path, planted(name, at))
    first = first_of(found)
    assert (first.kind, first.name, first.update) == (Kind.PROGRAM, name, update)
    assert set(found.program.same_before) == same - {name}
    assert found.program.last_same == last


@pytest.mark.parametrize(
    ("name", "kind", "last"),
    [("action", Kind.ACTION, "the states of step 5"), ("observation", Kind.SIMULATOR, "the actions of step 6")],
)
def test_actions_are_told_from_what_the_simulator_returns(
    plain: Recording, tmp_path: Path, name: str, kind: Kind, last: str
) -> None:
    """Plant one bit in an action, and in an observation, of the same step: the action comes first."""
    found = beside(plain, tmp_path, planted(name, 6))
    first = first_of(found)
    assert (first.kind, first.name) == (kind, f"env/{name}")
    assert first.first.states == 7
    assert found.program.last_same == last
    assert "policy" in found.program.same_before


def test_the_sentence_names_what_was_the_same(plain: Recording, tmp_path: Path) -> None:
    """Say where the runs part, and what did not differ until then."""
    found = beside(plain, tmp_path, planted("gradient", 1))
    assert verdict_of(found).text == (
        "The two recordings first differ at update 1 of gradient, after step 8 (4 s); until then, batch, policy, the "
        "actions and all that the simulator returned are the same."
    )
    found = compare(plain, train(tmp_path / "c.mcap", planted("policy", 0)))
    assert verdict_of(found).text == (
        "The two recordings first differ at update 0 of policy (policy/w), before the first state; nothing that was "
        "recorded precedes it."
    )


def test_other_numbers_of_updates_differ(plain: Recording, tmp_path: Path) -> None:
    """Find the update that one run has alone, although all states are the same."""
    found = beside(plain, tmp_path, nothing, extra=1)
    first = first_of(found)
    assert found.first is None
    assert (first.name, first.update) == ("policy", UPDATES + 1)
    assert first.reason == "a has 4 updates of it, b has 5"


def test_a_step_without_states_is_found_by_its_hash(tmp_path: Path) -> None:
    """Record every second state: what differs at an odd step first is known by the hash alone."""
    runs = [train(tmp_path / f"{i}.mcap", plant, stride=2) for i, plant in enumerate((nothing, planted("action", 7)))]
    first = first_of(compare(*runs))
    assert (first.kind, first.name) == (Kind.SIMULATOR, "states")
    assert first.first.states == 8


def test_arrays_of_one_side_are_named(tmp_path: Path) -> None:
    """Compare with a run that hashed nothing: the states are the same, and not everything was compared."""
    fields = (array_field("observation", "float64"),)
    for name, arrays in (("a", ("policy",)), ("b", ())):
        with RecordingWriter(
            tmp_path / f"{name}.mcap",
            simulator="mine",
            version="1",
            scene="toy",
            n_env=2,
            dt=0.5,
            steps=1,
            fields=fields,
        ) as log:
            log.append(np.zeros((2, 2)))
            for array in arrays:
                log.fingerprint(array, np.ones(2))
    found = compare(*(open_recording(tmp_path / f"{name}.mcap") for name in "ab"))
    assert found.bit_identical
    assert found.compared.left_out == ("hashes of policy: only in a",)


def test_the_command_says_so(tmp_path: Path) -> None:
    """Print the sentence and the table, write both as JSON, and end with 4."""
    train(tmp_path / "a.mcap")
    train(tmp_path / "b.mcap", extra=1)
    files = ("a.mcap", "b.mcap")
    done = call("gsb-diff", *files, "--all", "--json", "found.json", cwd=tmp_path, code=ExitCode.GATE_FAILED)
    assert done.stdout.startswith(
        "The two recordings first differ at update 4 of policy (a has 4 updates of it, b has 5)"
    )
    assert "parts of the program: 2 other state fields the same throughout" in done.stdout
    document = json.loads((tmp_path / "found.json").read_text())
    assert document["verdict"] == "different"
    assert document["first"] is None
    assert document["program"]["first"]["name"] == "policy"


@pytest.mark.parametrize(
    ("forge", "said"),
    [
        (
            lambda w, name: w._updates.update({name: w._updates.get(name, 0) * 2}),
            "/program/policy has an update out of",
        ),
        (lambda w, name: setattr(w, "_order", w._order * 2), "an update of /program is missing or there twice"),
        (lambda w, name: w._arrays.update({name: ()}), ""),
    ],
)
def test_hashes_out_of_order_are_damage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, forge: Callable[[ArrayHashWriter, str], Any], said: str
) -> None:
    """Refuse a recording whose updates are not numbered as they were written; repeating the layout is no damage."""
    write = ArrayHashWriter.write

    def forged(self: ArrayHashWriter, name: str, found: Hashed, *, states: int) -> None:
        forge(self, name)
        write(self, name, found, states=states)

    monkeypatch.setattr(ArrayHashWriter, "write", forged)
    recording = train(tmp_path / "a.mcap")
    if not said:
        verify(recording)
        return
    with pytest.raises(DamagedRecording, match=said):
        verify(recording)


def test_an_update_behind_the_states_is_damage(tmp_path: Path) -> None:
    """Refuse an update that follows more states than the recording has."""
    fields = (array_field("observation", "float64"),)
    with RecordingWriter(
        tmp_path / "a.mcap", simulator="mine", version="1", scene="toy", n_env=2, dt=0.5, steps=1, fields=fields
    ) as log:
        log.append(np.zeros((2, 2)))
        log.fingerprint("policy", np.ones(2), states=3)
    with pytest.raises(DamagedRecording, match="update 0 of policy follows 3 states, and there are 2"):
        verify(open_recording(tmp_path / "a.mcap"))


def test_copies_have_the_hashes(plain: Recording, tmp_path: Path) -> None:
    """Pack a recording, and recover one that was cut short: all arrays are compared, and gsb-info counts them."""
    path = Path(str(plain.path))
    packed, partial = tmp_path / "packed" / path.name, tmp_path / "c.mcap.partial"
    call("gsb-share", "pack", path, "--out", packed.parent, code=ExitCode.OK)
    partial.write_bytes(path.read_bytes()[:-100])
    call("gsb-share", "recover", partial, "--out", tmp_path / "c.mcap")
    for copy in (packed, tmp_path / "c.mcap"):
        found = compare(plain, open_recording(copy)).program
        assert (found.first, found.only_a) == (None, ())
    said = " ".join(call("gsb-info", packed, code=ExitCode.OK).stdout.split())
    assert "arrays of the program: policy (4 updates), batch (3 updates), gradient (3 updates)" in said


def compared(folder: Path, base: list[Path], head: list[Path]) -> dict[str, Any]:
    """What gsb-compare finds of the arrays."""
    target = folder / "found.json"
    code = ExitCode.OK if len(base) > 1 else ExitCode.NOTHING_COMPARABLE
    call("gsb-compare", "--base", *base, "--head", *head, "--no-cache", "--json", target, code=code)
    (found,) = json.loads(target.read_text())["compared"]
    (finding,) = (finding for finding in found["findings"] if finding["name"] == "arrays")
    assert isinstance(finding, dict)
    return finding


@pytest.mark.slow
def test_sets_of_runs_are_compared_by_their_arrays(tmp_path: Path) -> None:
    """Find that a gradient of head differs although no state does, and that one run a side does not show it."""
    plants = {"base": nothing, "same": nothing, "head": planted("gradient", 2)}
    base, same, head = (
        [Path(str(train(tmp_path / f"{name}-{i}.mcap", plant, run_index=i).path)) for i in range(2)]
        for name, plant in plants.items()
    )
    assert compared(tmp_path, base, same)["said"]["head"] == (
        "bit-identical in all updates: batch (3), gradient (3), policy (4)"
    )
    finding = compared(tmp_path, base, head)
    assert (finding["change"], finding["said"]["head"]) == ("changed", "gradient differs from update 2 on")
    finding = compared(tmp_path, base[:1], head[:1])
    assert finding["missing"].startswith("gradient differs from update 2 on, but runs of one side may differ")
    finding = compared(tmp_path, [base[0], head[1]], same)
    assert finding["missing"] == "runs of base differ from each other: gradient differs from update 2 on"


@pytest.mark.parametrize(("step", "env", "begins"), [(3, 1, True), (4, 1, False), (4, 0, True), (0, 0, False)])
def test_a_difference_at_the_begin_of_an_episode(tmp_path: Path, step: int, env: int, begins: bool) -> None:
    """Say where the reset of an environment made the state that differs first, of episodes of 3 and of 4 steps."""
    fields = (array_field("observation", "float64"), array_field("episode_step", "float64"))
    for name, more in (("a", 0.0), ("b", 1.0)):
        with RecordingWriter(
            tmp_path / f"{name}.mcap", simulator="mine", version="1", scene="toy", n_env=2, dt=0.5, steps=6,
            fields=fields,
        ) as log:  # fmt: skip
            for number in range(7):
                seen = np.array([number, number], dtype=np.float64)
                seen[env] += more * (number >= step)
                log.append(seen, np.array([number % 4, number % 3], dtype=np.float64))
    found = compare(open_recording(tmp_path / "a.mcap"), open_recording(tmp_path / "b.mcap"))
    assert found.first is not None and (found.first.step_a, found.first.env_a) == (step, env)
    assert found.first.begins_episode == begins
    said = f"first in env {env}, where an episode begins: env/observation"
    assert (said in verdict_of(found).text) == begins


@pytest.mark.parametrize(
    ("what", "step", "said"),
    [
        ("action", 3, "The actions differ first: all that the environments returned before that step is the same."),
        ("observation", 3, "The environments differ first: the actions up to that step are the same."),
        ("observation", 0, "What the reset returned differs already: no action precedes it."),
    ],
)  # fmt: skip
def test_without_hashes_of_the_program(tmp_path: Path, what: str, step: int, said: str) -> None:
    """Say whether actions or environments differ first, also of a program that hashes none of its arrays."""

    def run(name: str, plant: Plant) -> Recording:
        fields = (array_field("action", "float64"), array_field("observation", "float64"))
        seen = plant("observation", 0, np.array([0.5, 0.7]))
        path = tmp_path / f"{name}.mcap"
        with RecordingWriter(
            path, simulator="mine", version="1", scene="toy", n_env=2, dt=0.5, steps=5, fields=fields
        ) as log:
            log.append(np.zeros(2), seen)
            for number in range(1, 6):
                action = plant("action", number, seen * 0.1)
                seen = plant("observation", number, np.sin(seen + action))
                log.append(action, seen)
        return open_recording(path)

    def coarse() -> Recording:
        with RecordingWriter(
            tmp_path / "c.mcap", simulator="mine", version="1", scene="toy", n_env=2, dt=1.0, steps=1,
            fields=(array_field("action", "float64"), array_field("observation", "float64")),
        ) as log:  # fmt: skip
            for _ in range(2):
                log.append(np.zeros(2), np.array([0.5, 0.7]))
        return open_recording(tmp_path / "c.mcap")

    found = compare(run("a", nothing), run("b", planted(what, step)))
    assert found.program is None
    assert verdict_of(found).text.endswith(said)
    (before,) = (field.first_step for field in found.compared.fields if field.field == f"env/{what}")
    assert before == step
    if what == "action":  # of the steps between, nothing is known of the coarser one
        assert "differ first" not in verdict_of(compare(open_recording(tmp_path / "a.mcap"), coarse())).text
