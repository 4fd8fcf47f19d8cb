"""How much room Newton's buffers get: counted on MuJoCo C, with shapes that see each other from as far as Newton's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.buffer_sizes import Need, measure
from gpusimbench.recorder.simulators.mujoco.model import MjcfModel, compile_scene
from gpusimbench.recorder.simulators.mujoco.options import MjcfOptions
from gpusimbench.recorder.simulators.newton.model import detection_distance
from gpusimbench.recorder.simulators.newton.options import NewtonOptions
from gpusimbench.recorder.simulators.newton.solvers import Sizes

_MARGIN = 1.5  # Newton's collision detection makes other contacts of the same shapes, and its solvers other motions
_STEEL_ROWS = 2  # of a contact: one along its normal, and its part of what a patch of contacts has along the surface


def choose_sizes(scene: Scene, *, dt: float, seed: int, options: NewtonOptions, physics: MjcfOptions) -> Sizes:
    """Room for what MuJoCo C needs of the same scene with these options of its physics, and a margin; options that ask
    for a size get it."""
    compiled = compile_scene(scene, dt=dt, options=physics)
    compiled.model.geom_gap[:] = detection_distance(options)
    need = measure(compiled, dt=dt, seed=seed)
    if options.own_contacts:
        need = replace(need, margin=_MARGIN)
    # MuJoCo's pool holds pairs of shapes before it holds contacts
    contacts = need.contacts if options.own_contacts else need.pool
    match options.solver:
        case "steel":
            rows = _STEEL_ROWS * need.contacts
        case "vbd":
            rows = _contacts_of_a_body(compiled, need)
        case _:
            rows = need.rows
    return Sizes(
        contacts=options.max_contacts or need.size(contacts),
        rows=options.max_rows or need.size(rows),
        contacts_by="asked for" if options.max_contacts else need.sized_by(contacts),
        rows_by="asked for" if options.max_rows else need.sized_by(rows),
    )


def _contacts_of_a_body(compiled: MjcfModel, need: Need) -> int:
    """Of the moving body that has most of them, at any step."""
    body_of = np.asarray(compiled.model.geom_bodyid)
    most = 0
    for data in compiled.rollout(n_step=need.steps):
        bodies = body_of[np.asarray(data.contact.geom).reshape(-1)]
        most = max(most, int(np.bincount(bodies[bodies > 0], minlength=1).max()))
    return most
