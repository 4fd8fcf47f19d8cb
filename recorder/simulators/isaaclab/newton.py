"""Newton under Isaac Lab, with MuJoCo Warp as its solver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.model import ModelScene
from gpusimbench.recorder.simulators.buffer_sizes import measure
from gpusimbench.recorder.simulators.evidence import CONSTRAINT_ROWS, CONTACTS, SOLVER_ITERATIONS, Evidence
from gpusimbench.recorder.simulators.isaaclab.options import IsaacLabOptions
from gpusimbench.recorder.simulators.mujoco.model import MjcfModel, compile_scene, raised_tolerance
from gpusimbench.recorder.simulators.mujoco.options import MjcfOptions, own_options
from gpusimbench.recorder.simulators.snapshot import Envs, rows_of
from gpusimbench.schemas.provenance import Buffer, Counter, Deviation, OverflowBit

MODES = {"default": "not_guaranteed", "run-to-run": "run_to_run", "gpu-to-gpu": "gpu_to_gpu"}
"""Isaac Lab's deterministic_mode by determinism level."""

_INTEGRATORS = ("euler", "rk4", "implicitfast")

_FAULTY = "3."
"""Releases of MuJoCo Warp, as far as Isaac Lab 3.0 takes them, whose Hessian of an elliptic cone is indefinite where a
contact slips by less than 1e-5 m/s^2: 3.12 bounds the cube of the slip by the constant meant for the slip itself, 4.0
does not."""

_MARGIN = 2.5  # cubes that touch settle under other contacts: on an H200 rows came to 1.6 times those of MuJoCo C


class Newton:
    """MuJoCo Warp as the physics of an Isaac Lab simulation.

    cfg      Isaac Lab's configuration of it
    """

    counters: tuple[Counter, ...] = (CONTACTS, CONSTRAINT_ROWS, SOLVER_ITERATIONS)

    def __init__(self, scene: Scene, *, n_env: int, dt: float, seed: int, options: IsaacLabOptions, level: str) -> None:
        from isaaclab_newton.physics import MJWarpSolverCfg, NewtonCfg

        self._options = options
        self._n_env = n_env
        self._mode = MODES[level]
        compiled = _compiled(scene, dt=dt, options=options)
        need = replace(measure(compiled, dt=dt, seed=seed), margin=_MARGIN)
        self._contacts = options.max_contacts or need.size(need.pool)
        self._contacts_by = "asked for" if options.max_contacts else need.sized_by(need.pool)
        self._rows = options.max_rows or need.size(need.rows)
        self._rows_by = "asked for" if options.max_rows else need.sized_by(need.rows)
        self._of_a_file = isinstance(scene, ModelScene)
        file = compiled.model.opt if self._of_a_file else None
        self.cfg = NewtonCfg(
            solver_cfg=MJWarpSolverCfg(
                njmax=self._rows,
                nconmax=self._contacts,
                **_solver(options, file),
                disable_sensors=level != "default",  # a condition of deterministic modes; the scene has none
            ),
            deterministic_mode=self._mode,
        )

    def author(self, stage: Any, path: str) -> None:
        """The configuration says all."""

    def attach(self, sim: Any, rows: int) -> None:
        """Watch the solver from now on, with room for so many rows of counts."""
        import mujoco_warp as mjw
        import warp as wp

        manager = sim.physics_manager
        self._solver = manager._solver  # Isaac Lab shows the solver nowhere else
        self._solver.mjw_model.opt.warn_overflow = False  # the bits are recorded; printing them would fill the log
        self._bits = wp.zeros(self._n_env, dtype=wp.int32)
        self._row = wp.zeros(1, dtype=wp.int32)
        self._stored = tuple(wp.zeros((rows, self._n_env), dtype=wp.int32) for _ in range(1 + len(self.counters)))
        self.overflow_bits = tuple(
            # more iterations would have been of use: nothing was dropped
            OverflowBit(int(bit).bit_length() - 1, bit.name, fatal="ITERATIONS" not in bit.name)
            for bit in mjw.OverflowType
            if int(bit).bit_count() == 1
        )
        data = self._solver.mjw_data
        self.buffers = (
            _buffer("nconmax", data.naconmax // self._n_env, CONTACTS, self._contacts, self._contacts_by),
            _buffer("njmax", data.njmax, CONSTRAINT_ROWS, self._rows, self._rows_by),
        )
        # becomes part of the CUDA graph of a step
        manager.register_post_step_callback(self._gather)

    def _gather(self) -> None:
        overflow = self._solver.mjw_data.overflow
        self._launch("gather_bits", self._n_env, overflow, self._bits)
        overflow.zero_()  # the solver adds to them: what one step dropped is not to be seen at every later one

    def _launch(self, kernel: str, dim: int, *inputs: Any) -> None:
        import warp as wp

        from gpusimbench.recorder.simulators.newton import kernels

        wp.launch(getattr(kernels, kernel), dim=dim, inputs=list(inputs))

    def rewind(self) -> None:
        """Begin with the first row."""
        self._row.zero_()

    def store(self) -> None:
        """Store what the last step showed, and go on to the next row; nothing waits for the device."""
        data, n_env, row = self._solver.mjw_data, self._n_env, self._row
        bits, contacts, rows, iterations = self._stored
        self._launch("clear_counts", n_env, row, contacts)
        self._launch("count_worlds", data.naconmax, row, data.nacon, data.contact.worldid, contacts)
        self._launch("store_counts", n_env, row, data.nefc, rows)
        self._launch("store_counts", n_env, row, data.solver_niter, iterations)
        self._launch("store_bits", n_env, row, self._bits, bits)
        self._launch("next_row", 1, row)

    def evidence(self, rows: int) -> Evidence:
        """The evidence that the first rows hold."""
        bits, *counts = (array[:rows].numpy().copy() for array in self._stored)
        named = {counter.name: array for counter, array in zip(self.counters, counts, strict=True)}
        return Evidence(named, bits.astype(np.uint32))

    def kept(self) -> dict[str, NDArray[np.float32]]:
        """What decides the next step besides poses and speeds, [env, ...]: with what the solver begins."""
        return {"qacc_warmstart": np.array(self._solver.mjw_data.qacc_warmstart.numpy())}

    def put(self, arrays: Mapping[str, NDArray[Any]], envs: Envs) -> None:
        """Give some environments, or all, what ``kept`` kept of them, [env of envs, ...]."""
        held = self._solver.mjw_data.qacc_warmstart
        values = held.numpy().copy()
        values[rows_of(envs)] = arrays["qacc_warmstart"]
        held.assign(values)

    def in_force(self) -> dict[str, Any]:
        """The options that Newton has, as the solver has them."""
        import mujoco

        opt, model = self._solver.mj_model.opt, self._solver.mj_model
        found = {
            "solver": "mujoco_warp",
            "iterations": int(opt.iterations),
            "ls_iterations": int(opt.ls_iterations),
            "tolerance": float(opt.tolerance),
            "cone": mujoco.mjtCone(opt.cone).name.removeprefix("mjCONE_").lower(),
            "integrator": mujoco.mjtIntegrator(opt.integrator).name.removeprefix("mjINT_").lower(),
            "mujoco_solver": mujoco.mjtSolver(opt.solver).name.removeprefix("mjSOL_").lower(),
            "impratio": float(opt.impratio),
            "substeps": int(self.cfg.num_substeps),
        }
        if self._of_a_file:  # whose geoms have their own
            return found
        return {
            **found,
            "solref": [float(number) for number in model.geom_solref[0]],
            "solimp": [float(number) for number in model.geom_solimp[0]],
            "condim": int(model.geom_condim[0]),
        }

    def deviations(self) -> tuple[Deviation, ...]:
        """What the solver has otherwise than the model that Newton gave it."""
        held = float(self._solver.mjw_model.opt.tolerance.numpy()[0])
        return raised_tolerance(self._solver.mj_model.opt.tolerance, held)

    def switches(self) -> dict[str, Any]:
        """What decides which bits come out."""
        import mujoco_warp
        import newton
        import warp as wp

        return {
            "newton": newton.__version__,
            "mujoco_warp": mujoco_warp.__version__,
            "warp": wp.config.version,
            "deterministic_mode": self._mode,
            "contacts": "MuJoCo Warp",
        }

    def remarks(self) -> tuple[str, ...]:
        """What is known of this release and these options, and makes runs INVALID."""
        import mujoco_warp

        if self._options.cone != "elliptic" or not mujoco_warp.__version__.startswith(_FAULTY):
            return ()
        return (
            f"MuJoCo Warp {mujoco_warp.__version__} with elliptic cones: where touching bodies hardly slip, states can "
            "become not finite (mended in 4.0); cone=pyramidal does not have this fault",
        )

    def gates(self) -> list[str]:
        """What is dropped shows as bits."""
        return []

    def close(self) -> None:
        """Let go of the device's arrays."""
        for name in ("_solver", "_bits", "_row", "_stored"):
            vars(self).pop(name, None)


def _buffer(name: str, given: int, counter: Counter, wanted: int, by: str) -> Buffer:
    if given != wanted:
        by = f"{wanted} wanted ({by}), which Newton has changed"  # it gives more where the first state needs more
    return Buffer(name, given, "env", counter.name, by)


def _compiled(scene: Scene, *, dt: float, options: IsaacLabOptions) -> MjcfModel:
    if isinstance(scene, ModelScene):
        return compile_scene(scene, dt=dt, options=own_options(scene, {"cone": options.cone}))
    compiled = compile_scene(scene, dt=dt, options=MjcfOptions(cone=options.cone))
    compiled.model.geom_gap[:] = options.contact_offset - options.rest_offset  # as Newton reads them
    return compiled


def _solver(options: IsaacLabOptions, file: Any) -> dict[str, Any]:
    """What of Isaac Lab's configuration of the solver is chosen; what is no option of the adapter is the model
    file's."""
    import mujoco

    chosen = {"iterations": options.iterations, "ls_iterations": options.ls_iterations, "cone": options.cone}
    if file is None:
        return chosen
    integrator = mujoco.mjtIntegrator(file.integrator).name.removeprefix("mjINT_").lower()
    if integrator not in _INTEGRATORS:
        raise Refused(f"MuJoCo Warp has no integrator '{integrator}', which the model file asks for")
    return {
        **chosen,
        "impratio": float(file.impratio),
        "integrator": integrator,
        "enable_multiccd": not int(file.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_MULTICCD),
        "solver": "cg" if file.solver == mujoco.mjtSolver.mjSOL_CG else "newton",  # there is no PGS
    }
