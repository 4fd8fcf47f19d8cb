"""The JSON of the commands over shipped recordings, against files that are kept: a change of a value is a decision.

python -m tests.test_golden        writes the files anew; the commit that changes them names what has changed
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.json_keys import Keys, check, keys_of, write

ROOT = Path(__file__).resolve().parent.parent
GOLDEN = Path(__file__).resolve().parent / "golden"
_TOP = ("amd-r0", "amd-r1", "amd-r2", "pyramidal-r0", "pyramidal-r1", "xeon-r0", "xeon-r1", "xeon-r2")
_FILES = tuple(f"recordings/mujoco-{name}.mcap" for name in _TOP)
_H200 = "recordings/protocol-h200/physx-inclined-collision-n16-r"
_SWEEP = "recordings/sweeps-h100/warp-free-fall-n"
COMMANDS = {
    "eval": ("eval", *_FILES, "--no-cache"),
    "eval-sweep": ("eval", *(f"{_SWEEP}{n}-r0.mcap" for n in (512, 4096, 32768)), "--no-cache"),
    "check": ("check", *_FILES),
    "check-found": ("check", *sorted(str(p.relative_to(ROOT)) for p in (ROOT / "tests/hostile/found").glob("*.mcap"))),
    "info": ("info", _FILES[0], f"{_SWEEP}4096-r0.mcap", "tests/hostile/found/summary-count.mcap"),
    "diff": ("diff", _FILES[0], _FILES[3]),
    "diff-envs": ("diff", "recordings/h200/physx-spacing-0-inclined-collision-n16-r0.mcap"),
    "compare": (
        "compare", "--base", *(f"{_H200}{r}.mcap" for r in range(4)), "--head",
        *(f"{_H200}{r}.mcap" for r in range(4, 8)), "--no-cache",
    ),
}  # fmt: skip
LISTED = ("check", "compare", "diff", "info")  # others: tests/test_json_keys.py, tests/evaluator/test_json_page.py
_RELATIVE = 1e-9  # another processor rounds sums otherwise


def said(name: str) -> Any:
    """What a command writes as JSON, run as a user runs it in a checkout."""
    verb, *arguments = COMMANDS[name]
    done = subprocess.run(
        [sys.executable, "-P", "-m", f"gpusimbench.evaluator.cli.{verb}", *arguments, "--json", "-"],
        cwd=ROOT, capture_output=True, text=True, timeout=300, env={**os.environ, "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode in (0, 3, 4, 5), done.stderr
    document = json.loads(done.stdout)
    for recorded in document.get("files", ()) if verb == "info" else ():
        argv = recorded["provenance"]["argv"]  # a folder of the machine that recorded is none of what is kept
        argv[:] = ["FOLDER" if before == "--out" else text for before, text in zip(["", *argv], argv, strict=False)]
    return document


def listed(verb: str) -> Keys:
    """The keys of the kept files of a command."""
    files = [GOLDEN / f"{name}.json" for name, (command, *_) in COMMANDS.items() if command == verb]
    return keys_of((json.loads(file.read_text(encoding="utf-8")) for file in files), verb)


def differences(kept: Any, found: Any, where: str = "") -> list[str]:
    """Places at which two documents differ by more than rounding."""
    if isinstance(kept, dict) and isinstance(found, dict):
        here = [f"{where}/{key}: only in one" for key in kept.keys() ^ found.keys()]
        return here + [
            d for key in kept.keys() & found.keys() for d in differences(kept[key], found[key], f"{where}/{key}")
        ]
    if isinstance(kept, list) and isinstance(found, list):
        if len(kept) != len(found):
            return [f"{where}: {len(kept)} entries, now {len(found)}"]
        return [d for i, (a, b) in enumerate(zip(kept, found, strict=True)) for d in differences(a, b, f"{where}[{i}]")]
    if isinstance(kept, float) and isinstance(found, float):
        same = math.isclose(kept, found, rel_tol=_RELATIVE, abs_tol=1e-15)
    else:
        same = type(kept) is type(found) and kept == found
    return [] if same else [f"{where}: {kept!r}, now {found!r}"]


@pytest.mark.parametrize("name", COMMANDS)
def test_json_is_what_it_was(name: str) -> None:
    """Write the same keys, verdicts and numbers as before."""
    kept = json.loads((GOLDEN / f"{name}.json").read_text(encoding="utf-8"))
    assert differences(kept, said(name)) == []


@pytest.mark.parametrize("verb", LISTED)
def test_no_key_vanishes_while_the_version_stays(verb: str) -> None:
    """Have in the kept files, which the commands write, the keys that are listed for this version, and no other."""
    assert check(verb, listed(verb)) == []


def test_differences_are_seen() -> None:
    """See another number, another type, a key too many, and a shorter list; not the last bits of a number."""
    kept = {"a": [1.0, 2], "b": "x"}
    assert differences(kept, {"a": [1.0 + 1e-12, 2], "b": "x"}) == []
    assert differences(kept, {"a": [1.1, 2], "b": "x"}) == ["/a[0]: 1.0, now 1.1"]
    assert differences(kept, {"a": [1.0, 2.0], "b": "x"}) == ["/a[1]: 2, now 2.0"]
    assert differences(kept, {"a": [1.0], "b": "x"}) == ["/a: 2 entries, now 1"]
    assert differences(kept, {"a": [1.0, 2]}) == ["/b: only in one"]


if __name__ == "__main__":
    for each in COMMANDS:
        (GOLDEN / f"{each}.json").write_text(json.dumps(said(each), indent=1) + "\n", encoding="utf-8")
    for each in LISTED:
        write(each, listed(each))
