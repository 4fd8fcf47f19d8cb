"""How the tables of the documents call what was run: the simulator, and its options in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_PLAIN = ("impl", "backend", "solver")  # options that say what is run, and need not say their name
_ALWAYS = "impl"  # said also where the default is in force: the two are two engines
_DEVICE = "device"  # told by the device's model, in a place of its own


def name_of_run(simulator: str, given: Mapping[str, Any], in_force: Mapping[str, Any]) -> str:
    """The simulator and the options that were given.

    given     options as asked
    in_force  all options; those asked where the engine did not say them
    """
    plain = [str(in_force[name]) for name in _PLAIN if name in in_force and (name in given or name == _ALWAYS)]
    named = [f"{name}={value}" for name, value in sorted(given.items()) if name not in (*_PLAIN, _DEVICE)]
    return " ".join([simulator, *plain, *named])


def name_of_engine(simulator: str, in_force: Mapping[str, Any]) -> str:
    """The simulator and what of it ran, whether that was asked for or not."""
    return " ".join([simulator, *(str(in_force[name]) for name in _PLAIN if name in in_force)])
