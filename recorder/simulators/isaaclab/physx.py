"""PhysX under Isaac Lab: in the process (ovphysx), or within Isaac Sim (physx)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib import metadata
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.engine_log import EngineLog
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.isaaclab.options import GPU_SIZES, IsaacLabOptions
from gpusimbench.recorder.simulators.isaaclab.scene import BODY_LIMITS
from gpusimbench.recorder.simulators.snapshot import Envs
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.provenance import Buffer, Counter, Deviation, OverflowBit

if TYPE_CHECKING:
    from gpusimbench.recorder.simulators.buffer_sizes import Need

_LOST = (
    r"buffer overflow detected", r"will miss interactions", r"[Cc]ontacts have been dropped",
    r"accept dropped contacts", r"ran out of buffer space", r"falling back to default parameters",
)  # fmt: skip
_ERRORS = (r"\[Error\].*physx", r"PhysX error", r"PhysX Internal CUDA error")
_NOT_ON_THE_GPU = r"falling back"  # to the CPU, step after step

_PAIRS_MARGIN = 2.0  # PhysX finds other contacts of the same shapes, and its bodies make other motions
_MEASURED = ("gpu_max_rigid_contact_count", "gpu_max_rigid_patch_count", "gpu_found_lost_pairs_capacity")


def start_isaac_sim() -> None:
    """Start Isaac Sim without a window, once in a process; it ends with the process. UsageError where there is none."""
    if find_spec("isaacsim") is None:
        raise UsageError(
            "backend 'physx' of simulator 'isaaclab' needs Isaac Sim (isaacsim), which is not installed; "
            "backend 'ovphysx' is PhysX without it"
        )
    from isaaclab.utils.version import has_kit

    if not has_kit():
        from isaaclab.app import AppLauncher

        AppLauncher(headless=True)


class Physx:
    """PhysX as the physics of an Isaac Lab simulation.

    cfg      Isaac Lab's configuration of it
    buffers  that PhysX has on a GPU
    """

    counters: tuple[Counter, ...] = ()
    overflow_bits: tuple[OverflowBit, ...] = ()

    def __init__(
        self, scene: Scene, *, n_env: int, dt: float, seed: int, options: IsaacLabOptions, level: str, gpu: bool
    ) -> None:
        self._options = options
        self._gpu = gpu
        self._enhanced = level == "enhanced"
        self.buffers: tuple[Buffer, ...] = ()
        settings: dict[str, Any] = {}
        if options.backend == "physx":
            settings["bounce_threshold_velocity"] = options.bounce_threshold
        if gpu:
            self.buffers = _buffers(measured(scene, dt=dt, seed=seed, options=options), n_env, self._class(), options)
            settings |= {buffer.name: buffer.asked for buffer in self.buffers}
        self.cfg = self._class()(
            enable_enhanced_determinism=self._enhanced,
            enable_external_forces_every_iteration=options.external_forces_every_iteration,
            **settings,
        )
        self._log = EngineLog()  # PhysX tells of what it drops there, and nowhere else

    def _class(self) -> Any:
        if self._options.backend == "physx":
            from isaaclab_physx.physics import PhysxCfg

            return PhysxCfg
        from isaaclab_ov.physics import OvPhysxCfg

        return OvPhysxCfg

    def author(self, stage: Any, path: str) -> None:
        """Write what ovphysx's configuration has no name for on the stage's PhysicsScene, before it is read."""
        if self._options.backend != "ovphysx":
            return
        from pxr import Sdf

        prim = stage.GetPrimAtPath(path)
        kinds = Sdf.ValueTypeNames
        for name, kind, value in (
            ("solverType", kinds.Token, "TGS"),
            ("bounceThreshold", kinds.Float, self._options.bounce_threshold),
            ("enableCCD", kinds.Bool, False),
            ("enableStabilization", kinds.Bool, False),
        ):
            prim.CreateAttribute(f"physxScene:{name}", kind).Set(value)

    def attach(self, sim: Any, rows: int) -> None:
        """Nothing of PhysX is watched on the device."""

    def rewind(self) -> None:
        """Nothing is counted."""

    def store(self) -> None:
        """Nothing is counted."""

    def evidence(self, rows: int) -> Evidence | None:
        """PhysX has contacts to show only where a sensor asks for them, which would cost."""
        return None

    def kept(self) -> dict[str, NDArray[np.float32]]:
        """Nothing besides poses and speeds: PhysX shows none of it."""
        return {}

    def put(self, arrays: Mapping[str, NDArray[Any]], envs: Envs) -> None:
        """Nothing was kept."""

    def in_force(self) -> dict[str, Any]:
        """The options that PhysX has. What was chosen for a size of 0 is among the buffers."""
        options = self._options
        names = ("position_iterations", "velocity_iterations", "bounce_threshold", "friction_combine",
                 "restitution_combine", "external_forces_every_iteration")  # fmt: skip
        found = {name: getattr(options, name) for name in names}
        asked = {buffer.name: getattr(options, buffer.name) for buffer in self.buffers}
        return {**found, **asked, "solver": "TGS", **BODY_LIMITS}

    def deviations(self) -> tuple[Deviation, ...]:
        """None: what PhysX makes of parameters follows from the options."""
        return ()

    def switches(self) -> dict[str, Any]:
        """What decides which bits come out."""
        found = {
            "enhanced_determinism": self._enhanced,
            "external_forces_every_iteration": self._options.external_forces_every_iteration,
        }
        if self._options.backend == "physx":
            return {**found, "isaacsim": metadata.version("isaacsim")}
        # what is parsed has its bodies in another order in each environment
        environments = "clones of the first, told apart by numbers" if self._gpu else "parsed one by one"
        return {**found, "ovphysx": metadata.version("ovphysx"), "environments": environments}

    def remarks(self) -> tuple[str, ...]:
        """What PhysX has to say, it prints."""
        return ()

    def gates(self) -> list[str]:
        """Lines that PhysX has printed of what it dropped, and of errors."""
        patterns = (*_LOST, *_ERRORS, *((_NOT_ON_THE_GPU,) if self._gpu else ()))
        return [f"PhysX: {line.strip()}" for line in dict.fromkeys(self._log.matches(patterns))]

    def close(self) -> None:
        """Give the descriptors back."""
        self._log.close()


def measured(scene: Scene, *, dt: float, seed: int, options: IsaacLabOptions) -> Need:
    """Count on MuJoCo C, whose shapes see each other from as far as PhysX's."""
    from gpusimbench.recorder.simulators.buffer_sizes import measure_from_afar

    need = measure_from_afar(scene, dt=dt, seed=seed, reach=options.contact_offset)
    return replace(need, margin=_PAIRS_MARGIN)


def _buffers(need: Need, n_env: int, defaults: Any, options: IsaacLabOptions) -> tuple[Buffer, ...]:
    """Sizes for all environments: Isaac Lab's own where they are enough for what was measured."""
    shipped = defaults()
    needed = dict(zip(_MEASURED, (need.contacts, need.pairs, need.pairs), strict=True))
    found = []
    for name in GPU_SIZES:
        asked, own = getattr(options, name), getattr(shipped, name)
        if asked:
            found.append(Buffer(name, asked, "all", sized_by="asked for"))
        elif name in needed and n_env * need.size(needed[name]) > own:
            by = f"for each of {n_env} envs {need.sized_by(needed[name])}"
            found.append(Buffer(name, n_env * need.size(needed[name]), "all", sized_by=by))
        elif name in needed:
            by = f"Isaac Lab's own, as large as this or larger: for each of {n_env} envs {need.sized_by(needed[name])}"
            found.append(Buffer(name, own, "all", sized_by=by))
        else:
            found.append(
                Buffer(
                    name,
                    own,
                    "all",
                    sized_by="Isaac Lab's own; not measured, PhysX prints a line where it is not enough",
                )
            )
    return tuple(found)
