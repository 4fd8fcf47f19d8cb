"""Simulators by name, loaded only when asked for.

A distribution adds its own through the entry-point group ``gsb.simulators``: the entry's name is what users say, its
object is a ``Simulator`` subclass.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from importlib import import_module, metadata
from importlib.machinery import PathFinder
from importlib.util import find_spec

from gpusimbench.recorder.failure import in_words
from gpusimbench.recorder.interruption import blocked
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.base import Simulator
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.provenance import REAL
from gpusimbench.schemas.text import did_you_mean

ENTRY_POINTS = "gsb.simulators"
_TASKS = ("gym", "gymnasium")


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
    needs      what no installation brings, for simulators that want something of the user's

    Devices and precision are empty where only the adapter itself could tell: it is not loaded to find out.
    """

    name: str
    summary: str
    target: str
    requires: tuple[str, ...] = ()
    install: str = ""
    devices: tuple[str, ...] = ()
    precision: tuple[str, ...] = ()
    needs: str = ""

    def missing(self) -> tuple[str, ...]:
        """Import names that are not installed; nothing is imported to find out."""
        return tuple(name for name in self.requires if not is_there(name))

    def load(self) -> type[Simulator]:
        """The adapter; UsageError says how to install what is missing."""
        if missing := self.missing():
            raise UsageError(self.not_installed(missing))
        return self.adapter()

    def not_installed(self, missing: tuple[str, ...]) -> str:
        """What to say where these import names are missing."""
        return f"simulator '{self.name}' needs {', '.join(missing)}, which is not installed: {self.install}"

    def adapter(self) -> type[Simulator]:
        """The adapter, with or without its engine installed: what it declares can be read. UsageError where broken."""
        module, _, name = self.target.partition(":")
        try:
            # An import that is interrupted shows as one that is broken, and some engines start processes in theirs.
            with blocked():
                adapter: type[Simulator] = getattr(import_module(module), name)
        except Exception as error:  # whatever a third party's module raises
            raise UsageError(f"simulator '{self.name}' cannot be loaded: {in_words(error)}") from None
        if not (isinstance(adapter, type) and issubclass(adapter, Simulator) and hasattr(adapter, "Options")):
            raise UsageError(f"simulator '{self.name}' cannot be loaded: {self.target} is no Simulator with Options")
        return adapter


def is_there(name: str) -> bool:
    """Whether a module of that import name is installed; nothing is imported to find out."""
    package, *inner = name.split(".")
    try:
        found = find_spec(package)
        for part in inner:  # find_spec itself would import the package
            found = found and PathFinder.find_spec(f"{found.name}.{part}", found.submodule_search_locations)
    except Exception:  # whatever a finder raises
        return False
    return found is not None and found.origin is not None  # a folder of that name is no package


def _set_up(name: str) -> str:
    return f"gsb-record --setup {name} makes it an environment of its own"


def _extra(name: str) -> str:
    return f"pip install 'gpusimbench[{name}]', or in a clone: pip install '.[{name}]'"


def _engine(
    name: str,
    summary: str,
    adapter: str,
    *requires: str,
    install: str = "",
    devices: tuple[str, ...] = ("cuda", "cpu"),
    precision: tuple[str, ...] = ("float32",),
    needs: str = "",
) -> Entry:
    # the class `adapter` of NAME/simulator.py; `install` where no extra of this distribution has the name
    target = f"gpusimbench.recorder.simulators.{name}.simulator:{adapter}"
    return Entry(name, summary, target, (*requires, "psutil"), install or _extra(name), devices, precision, needs)


BUILT_IN = (
    _engine(
        "mujoco", "MuJoCo C on the CPU, float64, environments spread over threads", "MujocoC", "mujoco",
        devices=("cpu",), precision=("float64",),
    ),
    _engine(
        "warp", "MuJoCo Warp: MuJoCo in Warp kernels, CUDA graph capture on a GPU", "MujocoWarp", "mujoco_warp"
    ),
    _engine(
        "mjx", "MJX: MuJoCo in JAX (--impl jax) or in Warp kernels called from JAX (--impl warp)", "Mjx",
        "jax", "mujoco.mjx",
    ),
    _engine(
        "playground",
        "MuJoCo Playground: an environment of its own kind over MJX, with its default implementation", "Playground",
        "mujoco_playground",
    ),
    _engine("brax", "Brax: --solver positional, spring or generalized, in JAX", "Brax", "brax"),
    _engine("newton", "Newton: --solver mujoco, xpbd, steel and others, in Warp kernels", "Newton", "newton"),
    _engine(
        "genesis", "Genesis: its rigid solver in Quadrants kernels", "Genesis", "genesis", "torch",
        install=_set_up("genesis"), precision=("float32", "float64"),
    ),
    _engine(
        "physx", "PhysX by way of ovphysx, the engine of Isaac Lab 3, without Isaac Lab", "Physx",
        "ovphysx", "ovstage", "warp", install=_set_up("physx"),
    ),
    _engine(
        "isaaclab", "Isaac Lab 3 without Isaac Sim: --backend ovphysx or newton", "IsaacLab",
        "isaaclab", "torch", "mujoco", install=_set_up("isaaclab"),
    ),
    _engine(
        "sapien", "SAPIEN: PhysX, one system for each environment on the CPU, one for all on a GPU", "Sapien",
        "sapien", install=_set_up("sapien"),
    ),
    _engine(
        "maniskill", "ManiSkill: an environment of its own kind on SAPIEN; one environment on the CPU", "ManiSkill",
        "mani_skill", "sapien", "torch", install=_set_up("maniskill"),
    ),
    _engine(
        "madrona", "Madrona: worlds of an entity component system, stepped by a module that you compile", "Madrona",
        install=_extra("record"), needs="a module of your own build: docs/madrona.md",
    ),
    _engine(
        "calibration", "an instrument, no engine: results known beforehand, to test the whole pipeline with",
        "Calibration", "taichi", install=_set_up("calibration"),
    ),
)  # fmt: skip


def simulators() -> dict[str, Entry]:
    """All simulators by name: the built-in ones and those that installed distributions add."""
    known = {entry.name: entry for entry in BUILT_IN}
    for point in metadata.entry_points(group=ENTRY_POINTS):
        owner = point.dist.name if point.dist else "an installed distribution"
        known.setdefault(point.name, Entry(point.name, f"added by {owner}", point.value))
    return known


def find_simulator(name: str) -> Entry:
    """The simulator of that name; UsageError names the known ones."""
    for entry in BUILT_IN:  # without a look into every installed distribution, which would not replace it
        if entry.name == name:
            return entry
    known = simulators()
    if name not in known:
        hint = _packaged(name, known.values()) or did_you_mean(name, [*known, REAL])
        if name.lower() in _TASKS:
            hint = "; its tasks are recorded as a program steps them, by gpusimbench.wrap"
        if "," in name:
            hint = "; a call records one simulator: call it again for each of the others"
        raise UsageError(
            f"there is no simulator '{name}'; known: {', '.join(known)}, {REAL} (see gsb-record --list){hint}"
        )
    return known[name]


def _packaged(name: str, entries: Iterable[Entry]) -> str:
    # the end of a message on the name of a package, such as "mujoco_warp", that is not the simulator's name here
    package = name.lower().replace("-", "_")
    of = [entry.name for entry in entries if package in {one.replace(".", "_") for one in entry.requires}]
    return f"; did you mean '{of[0]}'?" if len(of) == 1 else ""


def able(scene: Scene) -> tuple[str, ...]:
    """Names of the simulators that have what a scene needs, with some of their options at least; engines need not be
    installed. Those that cannot be loaded are left out."""
    found = []
    for name, entry in simulators().items():
        try:
            adapter = entry.adapter()
        except UsageError:
            continue
        if scene.needs() <= adapter.offered(adapter.Options()):
            found.append(name)
    return tuple(found)
