"""The keys of the JSON of commands whose files are not kept in full, from small real runs.

python -m tests.test_json_keys [NAME...]    lists the keys anew
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import SMALL, call, recorded
from tests.evaluator import test_bisect, test_episodes, test_fit, test_history, test_import, test_probe, test_run
from tests.evaluator.sets import described
from tests.json_keys import check, keys_of, write
from tests.recorder.test_conformance import conformance
from tests.test_replay_episodes import record, recording_of

Documents = Iterator[Any]


def small_set() -> list[Path]:
    """Three runs of four environments."""
    return recorded("--sim", "mujoco", "--n-env", "4", "--runs", "3", *SMALL)


def of(command: str, *arguments: object, code: int | None = None, **keywords: Any) -> Any:
    """What a command writes to standard output."""
    return json.loads(call(command, *arguments, "--json", "-", code=code, **keywords).stdout)


def audits(folder: Path) -> Documents:
    """A replay with another solver, of two runs; a file that is none."""
    (folder / "bad.mcap").write_bytes(small_set()[0].read_bytes()[:-100])
    given = (*small_set()[:2], "--runs", 1, "--option", "cone=pyramidal", "--out", folder / "out")
    yield of("gsb-audit", *given)
    yield of("gsb-audit", small_set()[0], "--runs", 1, "--out", folder / "same", code=0)
    yield of("gsb-audit", folder / "bad.mcap", "--out", folder / "none", code=3)


def bisections(folder: Path) -> Documents:
    """Two environments that are the same."""
    yield of("gsb-bisect", *test_bisect._arguments(folder / "out", "one", "other"), code=5)


def conformances(folder: Path) -> Documents:
    """An adapter that meets some checks, fails others and skips others."""
    yield json.loads(conformance("--sim", "mujoco", "--option", "condim=1", "--json").stdout)


def episodes(folder: Path) -> Documents:
    """A policy, two policies, and a policy by number of environments."""
    few, many, near = (test_episodes.recording_of(*of, 4) for of in (("sweep", 4), ("sweep", 64), ("near", 64)))
    success = ("--success", "success", "--per-env", 2)
    yield of("gsb-episodes", many, *success, code=0)
    yield of("gsb-episodes", many, "--against", near, *success)
    yield of("gsb-episodes", few, many, *success, "--across", "n_env")


def fits(folder: Path) -> Documents:
    """A fit of friction."""
    yield json.loads((test_fit.of_friction() / "fit.json").read_text(encoding="utf-8"))


def histories(folder: Path) -> Documents:
    """A version that is slower and gives other states; a file that is none."""
    for index in range(10):
        test_history.write_point(folder, index, factor=1.2 if index >= 6 else 1.0)
    (folder / "v3" / "bad.mcap").write_bytes(b"bad")
    yield of("gsb-compare", "--history", folder, "--no-cache", code=3)


def imports(folder: Path) -> Documents:
    """An engine that takes a model file, and an engine that does not."""
    yield json.loads((test_import.of_walker() / "result.json").read_text(encoding="utf-8"))
    yield of("gsb-import", test_import.WALKER, "--sim", "calibration", "--out", folder, code=4)


def leaderboards(folder: Path) -> Documents:
    """A recording of an engine, and a file that is none."""
    runs = folder / "runs"
    described(runs, small_set()[:2])
    (runs / "bad.mcap").write_bytes(b"bad")
    call("gsb-share", "leaderboard", runs, "--out", folder / "board", "--no-cache", code=3)
    yield json.loads((folder / "board" / "leaderboard.json").read_text(encoding="utf-8"))


def probes(folder: Path) -> Documents:
    """A small probe."""
    yield json.loads((test_probe.of_mujoco() / "answers.json").read_text(encoding="utf-8"))


def records(folder: Path) -> Documents:
    """Runs, a sweep, and the lists."""
    given = ("--sim", "mujoco", "--scene", "free-fall", "--steps", 5, "--phases", "capture", "--no-view")
    for more in (
        (*given, "--n-env", 2, "--runs", 1, "--out", folder / "runs"),
        (*given, "--sweep", "1..2", "--runs", 1, "--out", folder / "sweep"),
        ("--list",),
        ("--list", "mujoco"),
        ("--list", "free-fall"),
    ):
        document = json.loads(call("gsb-record", *more, "--json", code=0).stdout)
        for simulator in document.get("simulators", ()):
            simulator["environment"] = None  # on some machines there is one
        yield document


def replays(folder: Path) -> Documents:
    """The same again, and a replay with another action."""
    again = ("--out", folder / "replay.mcap")
    yield of("gsb-replay", recording_of("Reacher-v5"), *again, code=0)
    record("Reacher-v5", folder / "nudged.mcap", nudged=7, max_episode_steps=15)
    yield of("gsb-replay", recording_of("Reacher-v5"), "--against", folder / "nudged.mcap", code=4)


def runs(folder: Path) -> Documents:
    """A program that repeats itself, and a program that does not."""
    for value in ("2", 'os.environ["GSB_RUN"][-1]'):
        words = test_run.program(folder, f'record("a.mcap", {value})\n')
        yield json.loads(call("gsb-run", "--json", "-", "--", *words, cwd=folder).stdout)


def verifications(folder: Path) -> Documents:
    """A set of recordings of which a file has changed."""
    made = described(folder / "set", small_set()[:1])
    (made / "README.md").write_text("changed")
    yield of("gsb-share", "verify", made, code=3)


MADE: dict[str, Callable[[Path], Documents]] = {
    "audit": audits, "bisect": bisections, "conformance": conformances, "episodes": episodes, "fit": fits,
    "history": histories, "import": imports, "leaderboard": leaderboards, "probe": probes, "record": records,
    "replay": replays, "run": runs, "verify": verifications,
}  # fmt: skip
SLOW = {"bisect", "conformance", "fit", "import", "probe"}


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in MADE])
def test_no_key_vanishes_while_the_version_stays(name: str, tmp_path: Path) -> None:
    """Have the keys that are listed for this version, with values of the listed types, and no other key."""
    assert check(name, keys_of(MADE[name](tmp_path), name)) == []


if __name__ == "__main__":
    for each in sys.argv[1:] or MADE:
        with tempfile.TemporaryDirectory() as folder:
            write(each, keys_of(MADE[each](Path(folder)), each))
