"""Which Python makes the runs of a simulator."""

from __future__ import annotations

from pathlib import Path

from recorder.environments.interpreter import RECORDING, Interpreter, at, own
from recorder.environments.store import find
from recorder.progress import say
from recorder.simulators.registry import Entry
from schemas.errors import UsageError


def interpreter_for(entry: Entry, given: Path | None = None) -> Interpreter:
    """The Python that the user gave; else this one, if it has the engine; else the simulator's own environment.

    UsageError where none of them has what the simulator needs, and how to get it.
    """
    if given is not None:
        chosen = at(given)
        if missing := chosen.missing((*RECORDING, *entry.requires)):
            raise UsageError(f"{given} cannot record '{entry.name}': it has no {', '.join(missing)}")
        return chosen
    missing = entry.missing()
    if not missing:
        return own()
    prepared = find(entry.name)
    if prepared is None:
        raise UsageError(entry.not_installed(missing))
    again = f"gsb-record --setup {entry.name} makes it anew"
    chosen = Interpreter(prepared.interpreter)
    if lost := chosen.missing((*RECORDING, *entry.requires)):
        raise UsageError(f"the environment in {prepared.folder} has no {', '.join(lost)} any more; {again}")
    if not prepared.current:
        say(f"the environment in {prepared.folder} was made from other requirements than this version's; {again}")
    return chosen
