"""Simulators by name, loaded only when asked for.

A distribution adds its own through the entry-point group ``gsb.simulators``: the entry's name is what users say, its
object is a ``Simulator`` subclass.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module, metadata
from importlib.util import find_spec

from recorder.interruption import blocked
from recorder.simulators.base import Simulator
from schemas.errors import UsageError

ENTRY_POINTS = "gsb.simulators"


@dataclass(frozen=True)
class Entry:
    """A simulator that can be asked for.

    name       what users say
    summary    one line
    target     "module:class"
    requires   import names that must be there
    install    how to get them
    devices    kinds of device that it steps on: "cpu", "cuda"
    precision  of its states: "float32", "float64"
    scenes     names of the scenes that it simulates

    The last three are empty where only the adapter itself could tell: it is not loaded to find out.
    """

    name: str
    summary: str
    target: str
    requires: tuple[str, ...] = ()
    install: str = ""
    devices: tuple[str, ...] = ()
    precision: tuple[str, ...] = ()
    scenes: tuple[str, ...] = ()

    def missing(self) -> tuple[str, ...]:
        """Import names that are not installed; nothing is imported to find out."""
        return tuple(name for name in self.requires if find_spec(name) is None)

    def load(self) -> type[Simulator]:
        """The adapter; UsageError says how to install what is missing."""
        if missing := self.missing():
            raise UsageError(
                f"simulator '{self.name}' needs {', '.join(missing)}, which is not installed: {self.install}"
            )
        module, _, name = self.target.partition(":")
        try:
            # An import that is interrupted shows as one that is broken, and some engines start processes in theirs.
            with blocked():
                adapter: type[Simulator] = getattr(import_module(module), name)
        except (ImportError, AttributeError) as error:
            raise UsageError(f"simulator '{self.name}' cannot be loaded: {error}") from None
        return adapter


BUILT_IN = (
    Entry(
        "mujoco",
        "MuJoCo C on the CPU, float64, environments spread over threads",
        "recorder.simulators.mujoco_c:MujocoC",
        requires=("mujoco", "psutil"),
        install="pip install 'gpusimbench[mujoco]', or in a clone: pip install '.[mujoco]'",
        devices=("cpu",),
        precision=("float64",),
        scenes=("inclined-collision", "free-fall", "franka"),
    ),
)


def simulators() -> dict[str, Entry]:
    """All simulators by name: the built-in ones and those that installed distributions add."""
    known = {entry.name: entry for entry in BUILT_IN}
    for point in metadata.entry_points(group=ENTRY_POINTS):
        owner = point.dist.name if point.dist else "an installed distribution"
        known.setdefault(point.name, Entry(point.name, f"added by {owner}", point.value))
    return known


def find_simulator(name: str) -> Entry:
    """The simulator of that name; UsageError names the known ones."""
    known = simulators()
    if name not in known:
        raise UsageError(f"there is no simulator '{name}'; known: {', '.join(known)}, real (see gsb-record --list)")
    return known[name]
