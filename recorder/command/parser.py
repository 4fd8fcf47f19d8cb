"""The parser of gsb-record, which knows what each argument is where it is not given, and what does not go together."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from gpusimbench.schemas.commands.parser import Parser
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.provenance import REAL

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
