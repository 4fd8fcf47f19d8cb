"""The parser of gsb-record: what its help says beside its options, what each argument is where it is not given, and
what does not go together."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from gpusimbench.schemas.commands.parser import Parser
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.provenance import REAL

EPILOG = """\
exit codes:
  0  every run is complete; of a sweep, every run below its last point, and at least one run
  1  a run failed or is INVALID (its recording gives the reason), or a replay exceeded its limits and was stopped
  2  wrong usage
  3  a run's process died, or the disk was full: data was lost

sweeps:
  --sweep records each number of environments, smallest first, and ends after the first number at which every run fails
  or is INVALID. A sweep searches for this limit, so such a failure does not make the command fail. If the first run of
  a number runs out of memory or of a buffer, is refused or times out, the other runs of this number are skipped.
  To continue a sweep, repeat the command with the same --out: existing recordings are kept. Two commands cannot record
  the same sweep in one folder at once: the second ends with exit code 1 and names the process of the first.

sets of runs:
  To continue an interrupted set, repeat the command with the same --out: only the runs that are not there are made. If
  the folder holds all --runs, the command makes as many again. After a refusal, all runs are made anew.

replays:
  --replay FILE repeats the run of a recording on this machine, with the recorded configuration, which is printed first
  and checked like arguments. The scene must be the same. --option (and --impl, --device...) replaces recorded options,
  and the new recording stores that. --runs, --phases, --view-env, --timeout, --python and --out are not taken from the
  recording.
  --replay FILE --from STEP begins at a snapshot that --snapshot STEP saved, and captures the states from there on. The
  engine loads the snapshot unchecked: continue only recordings of people whose code you would run.
  A replay that uses more memory, threads or disk than its recording accounts for is stopped, and its files are deleted.
  gsb-audit FILE replays a recording and compares the results.

clusters:
  --ray ADDRESS makes one run at a time on each GPU of a Ray cluster (on each node, if runs step on the CPU), and copies
  the recordings to --out on this machine. Only machines of one kind are used: the most frequent kind, or the kind with
  the resource --ray-resource. Every node needs this version of the project and the engine; see docs/cluster.md.

environments:
  Engines whose packages conflict with others get a Python environment each. --setup NAME makes the environment, in
  $GSB_ENVIRONMENTS or the user's data folder, from pinned requirements with hashes; later runs of this simulator use
  it. --python PATH uses an environment of your own. torch is installed as pip is configured on this machine.

files:
  OUT/SIM-SCENE-nN-rR-TIME.mcap  run R, begun at TIME (UTC); SIM with its solver and level of determinism
  OUT/NAME.mcap.partial  a run that is being made, or what a crash left of it, for gsb-share recover

see also:
  gsb-eval, which computes what the runs show
  gsb-audit, which replays and compares
  docs/simulators.md
  docs/timing.md

examples:
  gsb-record --list mujoco
  gsb-record --sim mujoco
  gsb-record --sim mujoco --scene free-fall --n-env 64 --runs 3 --out falling/
  gsb-record --sim mujoco --option cone=pyramidal --option integrator=Euler
  gsb-record --sim mujoco --scene free-fall --sweep 1..131072:4 --runs 3 --phases timed --timeout 600
  gsb-record --setup genesis && gsb-record --sim genesis
  gsb-record --replay theirs.mcap --runs 3
  gsb-record --sim real --trials trials.csv --unit cm
"""

USAGE = """\
%(prog)s --sim NAME [options]
       %(prog)s --sim real --trials CSV --unit {m,cm} [options]
       %(prog)s --replay FILE [options]
       %(prog)s --setup NAME [--python PATH]
       %(prog)s --list [NAME] [--json]"""


_NOT_TAKEN: Any = object()


class RecordParser(Parser):
    """The parser of gsb-record.

    unless_given  by kind of what is recorded ("simulated", "measured" or "replayed"): the arguments that are taken, by
                  name, and what each is where it is not given
    """

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **keywords)
        self.unless_given: dict[str, dict[str, Any]] = {"simulated": {}, "measured": {}, "replayed": {}}

    def take(
        self,
        group: argparse._ActionsContainer,
        *names: str,
        simulated: Any = _NOT_TAKEN,
        measured: Any = _NOT_TAKEN,
        replayed: Any = _NOT_TAKEN,
        **keywords: Any,
    ) -> None:
        """Add an argument, with what it is where it is not given; a kind of recording without such a value refuses the
        argument. {simulated}, {measured} and {replayed} in the help stand for these values."""
        for kind, value in (("simulated", simulated), ("measured", measured), ("replayed", replayed)):
            keywords["help"] = keywords["help"].replace(f"{{{kind}}}", f"{value}")
        action = group.add_argument(*names, **keywords)
        for kind, value in (("simulated", simulated), ("measured", measured), ("replayed", replayed)):
            if value is not _NOT_TAKEN:
                self.unless_given[kind][action.dest] = value


def fill(arguments: argparse.Namespace, unless_given: Mapping[str, dict[str, Any]]) -> None:
    """Give what was not given its default; UsageError for what was given and would be ignored."""
    if arguments.from_step is not None and arguments.replay is None:
        raise UsageError("--from needs --replay FILE: it is a step of that recording")
    replays, real = arguments.replay is not None, arguments.sim == REAL
    own = unless_given["replayed" if replays else "measured" if real else "simulated"]
    doing = "--replay takes this value from the recording"
    if not replays:
        doing = f"--sim {arguments.sim} does not use this option"
    whose = {
        "simulated": "--sim" if replays else "a simulator",
        "measured": "--sim" if replays else f"--sim {REAL}",
        "replayed": "--replay FILE",
    }
    for kind, taken in unless_given.items():
        for name in taken:
            if name not in own and getattr(arguments, name) is not None:
                raise UsageError(f"--{name.replace('_', '-')} is for {whose[kind]}; {doing}")
    if arguments.ray_resource is not None and arguments.ray is None:
        raise UsageError("--ray-resource needs --ray ADDRESS: it chooses nodes of that cluster")
    if arguments.sweep is not None and arguments.n_env is not None:
        raise UsageError("--sweep and --n-env cannot be used together: --sweep sets the number of environments")
    for name, default in own.items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, default)


def names() -> dict[str, tuple[str, ...]]:
    """Names that completion offers, by the destination of the option that takes them."""
    from gpusimbench.recorder.environments.store import SPECIFICATIONS
    from gpusimbench.recorder.scenes.registry import scene_names
    from gpusimbench.recorder.simulators.registry import simulators

    sims, scenes = tuple(simulators()), scene_names()
    return {"sim": (*sims, REAL), "scene": scenes, "setup": tuple(SPECIFICATIONS), "list": (*sims, *scenes)}
