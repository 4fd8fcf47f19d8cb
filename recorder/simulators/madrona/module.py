"""The user's simulator module: named by options, found, asked for what it promises, and held to it.

The obligations are those of the table in docs/madrona.md, under the same names; every error names the one that is not
met.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from gpusimbench.recorder.failure import Refused, cause_of
from gpusimbench.recorder.options import require
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.emit.deviations import combination, materials, other_restitution
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.provenance import Deviation

VARIABLE = "GSB_MADRONA_MODULE"
"""Environment variable with the module's import name, for when the option `module` is not given."""

CONTRACT = "docs/madrona.md"
REQUIRED_SETTINGS = ("solver", "num_substeps", "delta_t", "gravity", "restitution", "friction_combination")
METHODS = (
    "step", "body_names", "settings", "deviations", "position_tensor", "rotation_tensor", "velocity_tensor",
)  # fmt: skip

HONOURED = "scene"
"""What the setting `restitution` says where each contact has the scene's own."""

_FLOAT32 = 1e-6  # relative: a module keeps its numbers in float32


@dataclass(frozen=True)
class MadronaOptions:
    """Options of Madrona.

    module        import name of your simulator module; empty: what GSB_MADRONA_MODULE says
    device        cpu, cuda (the first GPU) or cuda:N
    num_substeps  of the solver in a step; 0: as many as the module has by itself
    """

    module: str = ""
    device: str = "cpu"
    num_substeps: int = 0

    def __post_init__(self) -> None:
        kind, colon, index = self.device.partition(":")
        if self.device not in ("cpu", "cuda") and not (kind == "cuda" and colon and index.isdecimal()):
            raise ValueError(f"device is cpu, cuda or cuda:N, not '{self.device}'")
        require(self, (lambda v: v >= 0, "0 (the module's own) or more"), "num_substeps")

    @property
    def gpu(self) -> int | None:
        """Number of the GPU that is asked for; None for the CPU."""
        return None if self.device == "cpu" else int(self.device.partition(":")[2] or 0)


def breach(module: str, obligation: str, what: str) -> UsageError:
    """The error that a module's obligation is not met."""
    return UsageError(f"madrona module '{module}': {what} (obligation '{obligation}' in {CONTRACT})")


class SimulatorModule:
    """A module that was imported.

    name     import name
    version  of the engine, as the module says
    digest   SHA-256 of the module's file; empty where it has none
    """

    def __init__(self, options: MadronaOptions) -> None:
        """Import it. UsageError where none is named, where it cannot be imported, or where it lacks a function."""
        self.name = options.module or os.environ.get(VARIABLE, "")
        if not self.name:
            raise UsageError(
                f"simulator 'madrona' needs a simulator module of your own build ({CONTRACT}): name it with "
                f"--option module=NAME or in {VARIABLE}"
            )
        try:
            self._module: ModuleType = import_module(self.name)
        except ImportError as error:
            raise breach(self.name, "module", f"cannot be imported: {error}; is its folder in PYTHONPATH?") from None
        for function in ("SimManager", "version"):
            if not callable(getattr(self._module, function, None)):
                raise breach(self.name, function, f"has no {function}")
        self.version = self._module.version()
        if not isinstance(self.version, str) or not self.version.strip():
            raise breach(self.name, "version", f"version() gives {self.version!r}, not a text that names the build")
        self.digest = _digest(self._module)

    def manager(self, scene: Scene, *, n_env: int, dt: float, seed: int, options: MadronaOptions) -> Any:
        """The module's SimManager for a scene. UsageError and Refused where it does not take what it is given."""
        self._check_scene(scene)
        mode = "CPU" if options.gpu is None else "CUDA"
        try:
            exec_mode = getattr(self._module.madrona.ExecMode, mode)
        except AttributeError:
            raise breach(self.name, "ExecMode", f"has no madrona.ExecMode.{mode}") from None
        try:
            manager = self._module.SimManager(
                exec_mode=exec_mode,
                gpu_id=options.gpu or 0,
                num_worlds=n_env,
                rand_seed=seed % 2**64,
                auto_reset=False,
                scene=scene.to_json(),
                delta_t=dt,
                num_substeps=options.num_substeps,
            )
        except TypeError as error:
            raise breach(self.name, "SimManager", f"SimManager does not take its arguments: {_line(error)}") from None
        except ValueError as error:
            if cause_of(error) != "ENGINE":
                raise
            raise Refused(f"madrona module '{self.name}' refuses scene '{scene.name}': {_line(error)}") from None
        for method in METHODS:
            if not callable(getattr(manager, method, None)):
                raise breach(self.name, method, f"SimManager has no {method}()")
        return manager

    def _check_scene(self, scene: Scene) -> None:
        built_for = getattr(self._module, "SCENES", None)
        if built_for is None:
            return
        if not isinstance(built_for, Mapping):
            raise breach(self.name, "SCENES", "SCENES is not a dictionary of SHA-256 by name of the scene")
        if scene.name not in built_for:
            raise UsageError(
                f"madrona module '{self.name}' was not built for scene '{scene.name}'; "
                f"it was for: {', '.join(built_for) or 'none'}"
            )
        if built_for[scene.name] != scene.sha256():
            raise breach(
                self.name, "SCENES",
                f"was built for another '{scene.name}': its SHA-256 is {built_for[scene.name]}, not {scene.sha256()}",
            )  # fmt: skip

    def check_names(self, manager: Any, scene: Scene) -> None:
        """UsageError where the rows of the tensors are not the scene's moving bodies, in its order."""
        names, expected = list(manager.body_names()), [body.name for body in scene.moving()]
        if names == expected:
            return
        if len(names) != len(expected):
            raise breach(self.name, "body_names", f"body_names() gives {len(names)} names; {len(expected)} bodies move")
        row = next(i for i, (found, wanted) in enumerate(zip(names, expected, strict=True)) if found != wanted)
        raise breach(
            self.name,
            "body_names",
            f"body_names() has {names[row]!r} in row {row}, where the scene has {expected[row]!r}",
        )

    def settings(self, manager: Any, scene: Scene, *, dt: float, options: MadronaOptions) -> dict[str, Any]:
        """What the module says is in force. UsageError where that lacks something, or is not what was asked for."""
        found = manager.settings()
        if not isinstance(found, Mapping):
            raise breach(self.name, "settings", f"settings() gives {type(found).__name__}, not a dictionary")
        settings = {str(key): value for key, value in found.items()}
        if missing := [key for key in REQUIRED_SETTINGS if key not in settings]:
            raise breach(self.name, "settings", f"settings() lacks {', '.join(missing)}")
        try:
            json.dumps(settings, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise breach(self.name, "settings", f"settings() cannot be recorded as JSON: {_line(error)}") from None
        if not _numbers(settings["delta_t"], dt):
            raise breach(self.name, "settings", f"delta_t is {settings['delta_t']!r}; {dt!r} was asked for")
        if not _numbers(settings["gravity"], *scene.gravity):
            raise breach(self.name, "settings", f"gravity is {settings['gravity']!r}; the scene's is {scene.gravity}")
        substeps, asked = settings["num_substeps"], options.num_substeps
        if not isinstance(substeps, int) or substeps < 1 or asked not in (0, substeps):
            raise breach(self.name, "settings", f"num_substeps is {substeps!r}; {asked or 'one or more'} was asked for")
        return settings

    def deviations(self, manager: Any, scene: Scene, settings: Mapping[str, Any]) -> tuple[Deviation, ...]:
        """What the module does not take from the scene: as its settings show, and as it says itself."""
        found = [combination("friction", str(settings["friction_combination"]), "as built")]
        restitution = settings["restitution"]
        found += [
            other_restitution(material, str(restitution), "the module has one for all contacts")
            for material in materials(scene)
            if restitution not in (HONOURED, material.restitution)
        ]
        for row in manager.deviations():
            try:
                parameter, wanted, used, reason = (str(item) for item in row)
            except (TypeError, ValueError):
                raise breach(
                    self.name, "deviations", f"deviations() has {row!r}, not (parameter, wanted, used, reason)"
                ) from None
            found.append(Deviation(parameter, wanted, used, reason))
        return tuple(found)


def _digest(module: ModuleType) -> str:
    path = getattr(module, "__file__", None)
    return hashlib.sha256(Path(path).read_bytes()).hexdigest() if path else ""


def _numbers(found: Any, *expected: float) -> bool:
    try:
        values = [float(found)] if len(expected) == 1 else [float(value) for value in found]
    except (TypeError, ValueError):
        return False
    return len(values) == len(expected) and all(
        math.isclose(value, wanted, rel_tol=_FLOAT32) for value, wanted in zip(values, expected, strict=True)
    )


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:300]
