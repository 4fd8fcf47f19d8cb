"""One instance of PhysX with one stage: from USD to columns of numbers; what it says while it runs, which is the only
sign of contacts that it dropped; and where its environments stand."""

from __future__ import annotations

import logging
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Plane, Scene, Vector
from gpusimbench.recorder.scenes.emit.usd import env_path
from gpusimbench.recorder.simulators.physx import libraries
from gpusimbench.recorder.simulators.snapshot import Envs
from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.scratch import empty_folder
from gpusimbench.schemas.writing import write_pieces

_LOGGER = "gpusimbench.recorder.simulators.physx"

_DROPPED = re.compile(
    r"buffer overflow detected|have been dropped|will miss interactions|collide with all environments"
    r"|accept dropped contacts|ran out of buffer space|falling back to (CPU|default parameters)",
    re.IGNORECASE,
)
"""Lines of PhysX's GPU library that mean that steps did not do all of their work, whatever their level.

"Contact buffer overflow detected, ...", "Patch buffer overflow detected, ...", "PxGpuDynamicsMemoryConfig::
collisionStackSize buffer overflow detected, ... Contacts have been dropped.", "The application needs to increase
PxGpuDynamicsMemoryConfig::foundLostPairsCapacity to ..., otherwise, the simulation will miss interactions"; and of its
clones: "the clone will collide with all environments". On the CPU: "ran out of buffer space for narrow phase", "Either
accept dropped contacts". And what is not simulated as asked for: "falling back to CPU simulation", "to default
parameters".
"""


_NUMBER = re.compile(r"\d+")

_ORDINAL = 1  # of the one version of the stage that there is
_NO_TURN = (0.0, 0.0, 0.0, 1.0)


def is_fatal(level: int, text: str) -> bool:
    """Whether a line makes a run worthless: an error of the engine's, or a sign of dropped contacts at any level."""
    return level >= logging.ERROR or bool(_DROPPED.search(text))


class NativeLog(logging.Handler):
    """Keeps the fatal lines, each once, with how often it came. To be opened when an instance is there.

    ovphysx hands every line of its process to one receiver, whatever its source, beside printing it. The receiver is
    shut off with the last instance. Lines that differ in their numbers alone, such as sizes that a buffer would need,
    are one; the first is kept.
    """

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._fatal: Counter[str] = Counter()
        self._first: dict[str, str] = {}  # line without its numbers -> line
        self._logger = logging.getLogger(_LOGGER)

    def open(self) -> None:
        """Begin to listen."""
        import ovphysx

        self._logger.setLevel(logging.WARNING)
        self._logger.propagate = False  # the engine prints its lines itself
        self._logger.addHandler(self)
        ovphysx.set_log_level(ovphysx.LogLevel.WARNING)
        ovphysx.enable_python_logging(_LOGGER, min_severity=ovphysx.LogLevel.WARNING)

    def emit(self, record: logging.LogRecord) -> None:
        """Take a line; called from the engine's threads, one at a time."""
        text = " ".join(record.getMessage().split())
        if is_fatal(record.levelno, text):
            self._fatal[self._first.setdefault(_NUMBER.sub("#", text), text)] += 1

    def take(self) -> list[str]:
        """The fatal lines since the last call, one sentence each, once all that were said have arrived."""
        import ovphysx

        ovphysx.flush_log()
        found, self._fatal, self._first = self._fatal, Counter(), {}
        return [f"PhysX says, {count} times: {text}" for text, count in found.items()]

    def peek(self) -> list[str]:
        """The fatal lines that the next call of `take` takes."""
        import ovphysx

        ovphysx.flush_log()
        return list(self._fatal)

    def close(self) -> None:
        """Stop listening."""
        import ovphysx

        self._logger.removeHandler(self)
        ovphysx.disable_python_logging()
        super().close()


class Session:
    """PhysX with the environments of a run.

    physx  ovphysx.PhysX
    log    what the engine says
    """

    def __init__(self, *, gpu: bool, threads: int) -> None:
        """Start the engine. On a GPU states stay there: nothing is read back after a step."""
        import ovphysx

        libraries.load()
        libraries.choose_processor(gpu=gpu)
        ovphysx.set_global_config(ovphysx.GlobalConfigKey.NUM_THREADS, threads)
        self._stage: Any = None
        self._queries: dict[Any, Any] = {}
        self.log = NativeLog()
        with libraries.quiet():
            if gpu:
                config = ovphysx.PhysXConfig(carbonite_overrides={"/physics/suppressReadback": True})
                self.physx = ovphysx.PhysX(config=config, active_cuda_gpus="0")
            else:
                self.physx = ovphysx.PhysX()
        self.log.open()

    def open(self, usd: str) -> None:
        """Read a stage."""
        import ovstage

        self._stage = ovstage.Stage("recorder")
        with empty_folder() as folder:
            path = folder / "scene.usda"
            write_pieces(path, [usd.encode()])
            domains = ovstage.PopulationDomain.ALL
            ovstage.population.open_usd(self._stage, str(path), ordinal=_ORDINAL, domains=domains)
        self._stage.advance_write_floor(ordinal=_ORDINAL).wait()
        self.physx.wait_task(self.physx.attach_ovstage(self._stage, read_ordinal=_ORDINAL))

    def clone(self, n_env: int, origins: Sequence[Vector]) -> None:
        """Copy environment 0 until there are n_env, each at its origin, or all at the same place."""
        if n_env == 1:
            return
        targets = [env_path(env) for env in range(1, n_env)]
        anchors = [(*origin, *_NO_TURN) for origin in origins[1:]] or None
        self.physx.wait_task(self.physx.clone(env_path(0), targets, anchor_transforms=anchors))

    @contextmanager
    def columns(self, kind: Any, names: Sequence[str]) -> Iterator[dict[str, Any]]:
        """Read-outs of all objects of a kind (ovphysx.types.SimObjectType), by name: an ovphysx.ReadGroup each.

        Their arrays lie where the engine computes and are gone when the context ends: whatever reads them must be done
        by then. Empty on a GPU before the first step.
        """
        if kind not in self._queries:
            self._queries[kind] = self.physx.query(kind, metadata=False).wait()
        with libraries.quiet():
            result = self.physx.read(self._queries[kind], list(names)).wait()
            try:
                groups: dict[str, Any] = {}
                while (group := result.fetch_next().wait()) is not None:
                    name = result.dictionary.token_to_string(group.attribute)
                    if name in groups:
                        raise GsbError(f"PhysX gives '{name}' in several parts, as of several scenes")
                    groups[name] = group
                yield groups
            finally:
                group = None
                groups.clear()
                result.groups.clear()
                result.close_sync()

    def write(self, kind: Any, paths: Sequence[str], columns: Mapping[str, NDArray[Any]]) -> None:
        """Write columns of these objects of a kind by name, [object, number], and of no others.

        Refused by a GPU before the first step.
        """
        with self.physx.query(kind, prim_paths=self.handles(paths), metadata=False).wait() as query:
            names = list(columns)
            with self.physx.write(query, names).wait() as session:
                while (group := session.fetch_next().wait()) is not None:
                    rows, target = self.rows([group], paths), group.tensors[0]
                    filled = np.empty(target.shape, columns[names[group.attribute_index]].dtype)
                    filled[rows] = columns[names[group.attribute_index]].reshape(filled.shape)
                    target.assign(filled)
                    if target.device.is_cuda:
                        import warp as wp

                        wp.synchronize_device(target.device)
                    session.commit_sync(group)
                    del group, target

    def handles(self, paths: Sequence[str]) -> list[int]:
        """The engine's numbers of these prims."""
        import ovstage

        with (
            ovstage.PathDictionary(self._stage) as dictionary,
            dictionary.create_path_list_from_strings(paths) as listed,
        ):
            return list(dictionary.get_paths(listed))

    def rows(self, groups: Iterable[Any], paths: Sequence[str]) -> list[int]:
        """The row of each of these prims in all of some groups, which are of these prims alone."""
        import ovstage

        wanted = self.handles(paths)
        with ovstage.PathDictionary(self._stage) as dictionary:
            found = [dictionary.get_paths(prims) for prims in {group.prim_list for group in groups}]
        rows = {prim: row for row, prim in enumerate(found[0])}
        missing = [path for path, prim in zip(paths, wanted, strict=True) if prim not in rows]
        if missing or len(rows) != len(wanted):
            there = f"{len(rows)} objects, not the {len(wanted)} of the scene"
            raise GsbError(f"PhysX has {there}{f'; there is no {missing[0]}' if missing else ''}")
        if any(prims != found[0] for prims in found):
            raise GsbError("PhysX gives the columns of its objects in different orders")
        return [rows[prim] for prim in wanted]

    def close(self) -> None:
        """End the engine. RuntimeError where an array of it is still in use."""
        for query in self._queries.values():
            query.close_sync()
        self._queries.clear()
        if self._stage is not None:
            self.physx.wait_task(self.physx.detach_ovstage())
            self._stage.destroy()
            self._stage = None
        self.log.close()
        self.physx.destroy()


def grid_origins(n_env: int, spacing: float) -> tuple[Vector, ...]:
    """Origin of each environment [m]: on a square grid, numbered square by square, so that they do not depend on how
    many there are. Empty where the spacing is 0."""
    return tuple((spacing * x, spacing * y, 0.0) for x, y in map(_cell, range(n_env))) if spacing else ()


def every(n_env: int, envs: Envs) -> range | list[int]:
    """The environments that are meant."""
    return range(n_env) if envs is None else [int(env) for env in envs]


def _cell(env: int) -> tuple[int, int]:
    # the first n * n fill a square: cell (n, 0) .. (n, n) and then (n - 1, n) .. (0, n) make the next one
    side = math.isqrt(env)
    rest = env - side * side
    return (side, rest) if rest <= side else (2 * side - rest, side)


def shared_bodies(scene: Scene, spacing: float) -> tuple[str, ...]:
    """Names of the fixed bodies of which one serves all environments: all of them where the spacing is 0, else planes.

    A plane has no edge: every environment would meet those of all others.
    """
    fixed = [body for body in scene.bodies if body.fixed]
    if not spacing:
        return tuple(body.name for body in fixed)
    return tuple(body.name for body in fixed if isinstance(body.shape, Plane))
