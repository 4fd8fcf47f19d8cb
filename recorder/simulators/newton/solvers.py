"""Newton's solvers: how each is made, and what it has in force."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

from gpusimbench.recorder.simulators.mujoco.options import MjcfOptions
from gpusimbench.recorder.simulators.newton.model import detection_distance
from gpusimbench.recorder.simulators.newton.options import NewtonOptions

_CLASSES = {
    "mujoco": "SolverMuJoCo",
    "xpbd": "SolverXPBD",
    "steel": "SolverSteel",
    "semi-implicit": "SolverSemiImplicit",
    "featherstone": "SolverFeatherstone",
    "vbd": "SolverVBD",
    "kamino": "SolverKamino",
}


@dataclass(frozen=True)
class NewtonSizes:
    """Room for contacts and rows, and how each came about, in words.

    contacts  per environment
    rows      of constraints per environment; of VBD, which has none, entries of the list of contacts of each body
    """

    contacts: int
    rows: int
    contacts_by: str = ""
    rows_by: str = ""


def register(options: NewtonOptions) -> Callable[[Any], None]:
    """Adds to a builder what the solver wants to know of shapes and joints beyond Newton's own attributes."""
    from newton import solvers

    add: Callable[[Any], None] = getattr(solvers, _CLASSES[options.solver]).register_custom_attributes
    return add


def make_solver(
    model: Any,
    options: NewtonOptions,
    physics: MjcfOptions | None,
    sizes: NewtonSizes,
    mode: Any,
    *,
    multiccd: bool | None = None,
) -> Any:
    """The solver that the options ask for.

    physics   options of MuJoCo's physics that the MJCF asks for; None of scenes that do not come as MJCF
    mode      warp.DeterministicMode; the engine raises ValueError where the solver does not have it
    multiccd  of the MJCF, as of World; None for the default of SolverMuJoCo, which is not that of MJCF
    """
    from newton import solvers

    chosen: dict[str, Any] = {"iterations": options.iterations} if options.iterations else {}
    match options.solver:
        case "mujoco":
            if physics is not None:  # SolverMuJoCo's own defaults are not those of MJCF
                chosen |= {name: getattr(physics, name) for name in ("ls_iterations", "tolerance", "impratio")}
                chosen["integrator"] = physics.integrator.lower()
            solver = solvers.SolverMuJoCo(
                model,
                **chosen,
                njmax=sizes.rows,
                nconmax=sizes.contacts,
                cone=options.cone,
                enable_multiccd=multiccd,
                solver=options.mujoco_solver.lower(),
                use_mujoco_contacts=options.use_mujoco_contacts,
                kinematic_switchable_roots=False,  # nothing becomes kinematic
                deterministic=mode,
            )
            solver.mjw_model.opt.warn_overflow = 0  # the bits are recorded; printing them would fill the log
            return solver
        case "xpbd":
            return solvers.SolverXPBD(model, **chosen, enable_restitution=options.rebounds, deterministic=mode)
        case "steel":
            model.steel.rigid_body_angular_damping.zero_()  # nothing in a scene slows a spin
            return solvers.SolverSteel(
                model,
                **chosen,
                enable_restitution=options.rebounds,
                free_body_constraint_max=sizes.rows,
                warn_constraint_overflow=False,  # watched and recorded
                deterministic=mode,
            )
        case "semi-implicit":
            return solvers.SolverSemiImplicit(model, angular_damping=0.0, deterministic=mode)
        case "featherstone":
            return solvers.SolverFeatherstone(model, angular_damping=0.0, deterministic=mode)
        case "vbd":
            return solvers.SolverVBD(model, **chosen, rigid_body_contact_buffer_size=sizes.rows, deterministic=mode)
    config = solvers.SolverKamino.Config()
    if options.iterations:
        config.padmm.max_iterations = options.iterations
    return solvers.SolverKamino(model, config=config)


def in_force(solver: Any, options: NewtonOptions, *, mjcf: bool) -> dict[str, Any]:
    """Every option as the solver has it; None for those that it does not have.

    mjcf  the scene came as MJCF, whose geoms have contact parameters of their own
    """
    found: dict[str, Any] = {field.name: None for field in fields(options)}
    found |= {"solver": options.solver, "substeps": options.substeps, "device": str(solver.model.device)}
    # as asked for; the buffers, by the engine's names, say what was measured
    found |= {"max_contacts": options.max_contacts or None, "max_rows": options.max_rows or None}
    found["gap"] = detection_distance(options)
    return found | _of_solver(solver, options, mjcf)


def _of_solver(solver: Any, options: NewtonOptions, mjcf: bool) -> dict[str, Any]:
    match options.solver:
        case "mujoco":
            return _mujoco(solver, options, mjcf)
        case "xpbd":
            return {
                "iterations": solver.iterations,
                "restitution": solver.enable_restitution,
                "restitution_iterations": solver.rigid_contact_restitution_iterations,
                "rigid_contact_relaxation": solver.rigid_contact_relaxation,
                "rigid_contact_con_weighting": solver.rigid_contact_con_weighting,
                "angular_damping": solver.angular_damping,
            }
        case "steel":
            names = ("iterations", "baumgarte", "cfm", "relaxation", "solve_mode", "friction_anchor_beta",
                     "restitution_velocity_threshold")  # fmt: skip
            return {
                "restitution": solver.enable_restitution,
                "angular_damping": 0.0,
                **{name: getattr(solver, name) for name in names},
            }
        case "semi-implicit":
            return {**_penalty(options), "angular_damping": solver.angular_damping}
        case "featherstone":
            return {
                **_penalty(options),
                "angular_damping": solver.angular_damping,
                "update_mass_matrix_interval": solver.update_mass_matrix_interval,
            }
        case "vbd":
            found = {"iterations": solver.iterations, "friction_epsilon": solver.friction_epsilon}
            return {**_penalty(options), **found}
    config = solver._config  # there is no public way to what is in force
    return {"iterations": config.padmm.max_iterations, "dynamics_solver": config.dynamics_solver,
            "integrator": config.integrator}  # fmt: skip


def _penalty(options: NewtonOptions) -> dict[str, Any]:
    return {"ke": options.ke, "kd": options.kd, "kf": options.kf}


def _mujoco(solver: Any, options: NewtonOptions, mjcf: bool) -> dict[str, Any]:
    import mujoco

    opt, model = solver.mj_model.opt, solver.mj_model
    of_geoms: dict[str, Any] = {}
    if not mjcf:  # every geom has the same
        of_geoms = {
            "ke": options.ke,
            "kd": options.kd,
            "solref": [float(number) for number in model.geom_solref[0]],
            "solimp": [float(number) for number in model.geom_solimp[0]],
            "condim": int(model.geom_condim[0]),
        }
    return {
        **of_geoms,
        "integrator": _word(mujoco.mjtIntegrator(opt.integrator)),
        "cone": _word(mujoco.mjtCone(opt.cone)),
        "mujoco_solver": _word(mujoco.mjtSolver(opt.solver)),
        "iterations": int(opt.iterations),
        "ls_iterations": int(opt.ls_iterations),
        "tolerance": float(opt.tolerance),
        "impratio": float(opt.impratio),
        "use_mujoco_contacts": options.use_mujoco_contacts,
    }


def _word(choice: Any) -> str:
    """mjCONE_ELLIPTIC as "elliptic"."""
    return str(choice.name.partition("_")[2].lower())
