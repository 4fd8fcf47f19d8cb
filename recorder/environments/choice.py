"""Which Python makes the runs of a simulator."""

from __future__ import annotations

import subprocess
from pathlib import Path

from gpusimbench.recorder.environments.interpreter import RECORDING, Interpreter, at, own
from gpusimbench.recorder.environments.store import find
from gpusimbench.recorder.scenes.registry import SCENES
from gpusimbench.recorder.sets.progress import say
from gpusimbench.recorder.simulators.registry import BUILT_IN, Entry
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.scratch import scratch_folder

_KNOWS = """
import sys
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas.errors import UsageError
try:
    find_simulator(sys.argv[1]).load()
    for scene in sys.argv[2:]:
        make_scene(scene)
except UsageError as error:
    sys.exit(str(error))
"""


def check_known(interpreter: Interpreter, simulator: str, scene: str | None) -> None:
    """UsageError where another Python lacks a third party's simulator or scene that this one has.

    scene  name of a registered scene; None: the run brings its own
    """
    if interpreter.own or (simulator in {entry.name for entry in BUILT_IN} and (scene is None or scene in SCENES)):
        return
    with scratch_folder() as (folder, _):
        done = subprocess.run(
            interpreter.command("-c", _KNOWS, simulator, *filter(None, [scene])),
            env=interpreter.environment(folder), capture_output=True, text=True,
        )  # fmt: skip
    if done.returncode:
        said = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
        raise UsageError(f"{interpreter.python} cannot record this; install the package there too: {said}")


def interpreter_for(entry: Entry, given: Path | None = None) -> Interpreter:
    """The Python that the user gave; else this one, if it has the engine; else the simulator's own environment.

    UsageError where none of them has what the simulator needs, and how to get it.
    """
    wanted = tuple(dict.fromkeys((*RECORDING, *entry.requires)))
    if given is not None:
        chosen = at(given)
        if missing := chosen.missing(wanted):
            names = " ".join(name.replace("google.protobuf", "protobuf") for name in missing if name in RECORDING)
            how = f"; {chosen.python} -m pip install {names}" if names else ""
            raise UsageError(f"{given} cannot record '{entry.name}': it has no {', '.join(missing)}{how}")
        return chosen
    missing = entry.missing()
    if not missing:
        return own()
    prepared = find(entry.name)
    if prepared is None:
        raise UsageError(entry.not_installed(missing))
    again = f"gsb-record --setup {entry.name} makes it anew"
    chosen = Interpreter(prepared.interpreter)
    if lost := chosen.missing(wanted):
        raise UsageError(f"the environment in {prepared.folder} has no {', '.join(lost)} any more; {again}")
    if not prepared.current:
        say(f"the environment in {prepared.folder} was made from other requirements than this version's; {again}")
    return chosen
