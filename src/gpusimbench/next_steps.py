"""What can be done next with what is in a folder: recordings, what a crash left, reports."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from gpusimbench.schemas import PARTIAL

_MOST_FOLDERS = 200
"""Folders that are looked into; a home folder has many."""

_MARK = b'<meta name="generator" content="gpusimbench'
"""In the head of every page of results that the evaluator writes."""

_HEAD_BYTES = 16 << 10
_RECORDER = re.compile(r"-n\d+-r\d+-\d{8}T\d{6}Z\.mcap$")
"""Ends the names that gsb-record gives; a file of another name is likely to be of a user's program."""

_OF_COMMANDS = frozenset({"audit", "fit", "imports"})
"""Default folders of gsb-audit, gsb-fit and gsb-import, which evaluate their recordings themselves."""

_SHOWN = 3  # folders
_COLUMN = 44


@dataclass(frozen=True)
class Found:
    """A folder with recordings or a page of results.

    recordings  how many
    programs    how many of them are likely to be of programs of the user's
    unfinished  what a crash left of a recording, or is being made
    newest      when the newest of the recordings was written [s]; 0 without any
    page        of results; None where there is none
    """

    folder: Path
    recordings: int = 0
    programs: int = 0
    unfinished: tuple[Path, ...] = ()
    newest: float = 0.0
    page: Path | None = None


def next_steps(folder: Path = Path()) -> list[str]:
    """About ten lines: what is in a folder and the folders in it, and the commands that go on from there."""
    found = sorted(filter(None, map(_look, _folders(folder))), key=lambda f: -f.newest)
    sets = [f for f in found if f.recordings]
    pages = [f.page for f in found if f.page]
    unfinished = [path for f in found for path in f.unfinished]
    if not found:
        return [*_without_recordings(), "", *_more()]
    steps = [*_of_sets([f for f in sets if f.folder.name not in _OF_COMMANDS] or sets), *_of_pages(pages)]
    if unfinished:
        steps.append((f"gsb share recover {_word(unfinished[0])}", "what a crash left of a recording"))
    if not sets:
        steps.append(("gsb record --sim mujoco", "record a set of runs into runs/"))
    return [_here(sets, pages, unfinished), *map(_step, steps), "", *_more()]


def _folders(folder: Path) -> Iterator[Path]:
    yield folder
    try:
        with os.scandir(folder) as entries:
            names = sorted(e.name for e in entries if not e.name.startswith(".") and e.is_dir())
    except OSError:
        return
    yield from (folder / name for name in names[:_MOST_FOLDERS])


def _look(folder: Path) -> Found | None:
    recordings, programs, unfinished, newest, page = 0, 0, [], 0.0, None
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.name.endswith(".mcap"):
                    recordings += 1
                    programs += not _RECORDER.search(entry.name)
                    newest = max(newest, entry.stat().st_mtime)
                elif entry.name.endswith(f".mcap{PARTIAL}") and entry.stat().st_size:
                    unfinished.append(folder / entry.name)
                elif entry.name == "index.html" and _is_ours(Path(entry.path)):
                    page = folder / entry.name
    except OSError:  # a folder of somebody else's, or a file that is gone again
        return None
    if not recordings and not unfinished and page is None:
        return None
    return Found(folder, recordings, programs, tuple(sorted(unfinished)), newest, page)


def _is_ours(page: Path) -> bool:
    with page.open("rb") as stream:
        return _MARK in stream.read(_HEAD_BYTES)


def _without_recordings() -> list[str]:
    install = [] if find_spec("mujoco") else [("pip install 'gpusimbench[mujoco]'", "first: a simulator, MuJoCo C")]
    steps = [
        *install,
        ("gsb record --list", "simulators, where each is installed, and scenes"),
        ("gsb record --sim mujoco", "16 environments, 10 runs, into runs/"),
        ("gsb eval runs", "then: speed, memory and determinism of these runs"),
        ("gsb run -- python train.py", "or: is your program, which calls gpusimbench.wrap, reproducible?"),
    ]
    return ["There are no recordings here. To make some:", *map(_step, steps)]


def _of_sets(sets: list[Found]) -> Iterator[tuple[str, str]]:
    if not sets:
        return
    newest = _word(sets[0].folder)
    yield f"gsb eval {newest}", "speed, memory, determinism and physics"
    yield f"gsb eval {newest} --html report", "the same as a page with figures"
    if sets[0].programs:
        yield f"gsb episodes {newest}", "success rate and return of a policy on a task"
    yield f"gsb check {newest}", "whether the files are whole"
    yield f"gsb view {newest}", "environments in motion"
    if len(sets) > 1:
        older = _word(sets[1].folder)
        yield f"gsb compare {older} {newest}", "whether the newer set is worse than the older"
    else:
        yield "gsb record --sim NAME --out other", "a second set, to compare with: gsb record --list has the names"


def _of_pages(pages: list[Path]) -> Iterator[tuple[str, str]]:
    for page in pages[:_SHOWN]:
        yield str(page), "a page of results: open it in a browser"


def _here(sets: list[Found], pages: list[Path], unfinished: list[Path]) -> str:
    named = [f"{_count(f.recordings, 'recording')} in {_place(f.folder)}" for f in sets[:_SHOWN]]
    if more := sets[_SHOWN:]:
        named.append(f"{_count(sum(f.recordings for f in more), 'recording')} in {_count(len(more), 'other folder')}")
    if unfinished:
        named.append(f"{_count(len(unfinished), 'unfinished recording')}")
    if pages:
        named.append(_count(len(pages), "page") + " of results")
    return f"Here: {', '.join(named)}."


def _more() -> list[str]:
    return [_step(("gsb --help", "all commands; gsb VERB --help has the options of one"))]


def _step(step: tuple[str, str]) -> str:
    command, meaning = step
    return f"  {command:<{_COLUMN}}  {meaning}"


def _count(number: int, what: str) -> str:
    return f"{number} {what}" + "s" * (number != 1)


def _place(folder: Path) -> str:
    return "this folder" if folder == Path() else f"{folder}/"


def _word(path: Path) -> str:
    return shlex.quote(str(path))
