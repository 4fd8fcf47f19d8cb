"""The laws of the scene free-body: angular momentum, energy and period of bodies that turn without a torque."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.physics.closed_form import rotation_period
from gpusimbench.evaluator.metrics.physics.solids import rotations
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.physics.canonical.motion import bodies_of, cycles, fewest_periods, unevenness
from gpusimbench.evaluator.runs.physics.facts import LawValues
from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording

Array = npt.NDArray[np.float64]

_LARGE = 1e6
_SMALL = 1e-9
_SHARE = 1e-2  # of the tolerance, below which an error is nothing beside a change that shows
_NUDGE = 1e-4  # share of a moment by which its effect on the period is measured


def free_body_laws(recording: Recording) -> tuple[LawValues, ...] | Missing:
    """The laws, or why none can be measured; DamagedRecording where the scene does not describe such bodies."""
    read = bodies_of(recording)
    if isinstance(read, Missing):
        return read
    walk, states, time = read
    if states.angular is None or states.orientation is None:
        return Missing("angular velocities and orientations were not both recorded")
    if not states.angular[0].any(axis=-1).all():
        return Missing("a body does not turn at the start")
    moments = _moments(recording, walk.items)
    found: list[LawValues] = []
    for index, (_, name) in enumerate(walk.items):
        turn = rotations(states.orientation[:, :, index])
        spin = np.einsum("reji,rej->rei", turn, states.angular[:, :, index])
        found += _body(name, moments[index], time, turn, spin, recording.configuration.dt)
    return tuple(found)


def _body(name: str, moments: Array, time: Array, turn: Array, spin: Array, dt: float) -> list[LawValues]:
    """The laws of a body, of its rotations [row, env, 3, 3] and angular velocities about its own axes [row, env, 3]."""
    momentum = np.einsum("reij,rej->rei", turn, spin * moments)
    energy = (spin**2 @ moments) / 2.0
    step = float(np.linalg.norm(spin[0], axis=-1).max()) * dt
    turned = np.linalg.norm(momentum[-1] - momentum[0], axis=-1) / np.linalg.norm(momentum[0], axis=-1)
    gained = energy[-1] / energy[0] - 1.0
    none = (0.0,) * len(gained)
    along, lost = _damped(momentum[0], momentum[-1], gained, step)
    # a damping that shortens errors turns the smallest of them over
    over = float(along.mean()) < 0.0 and float(turned.min()) < float(turned.mean()) / 2.0
    whole = float(time[-1])
    order = np.argsort(moments)
    ascending, start = moments[order], spin[0][:, order]
    predicted = rotation_period(ascending, start)
    nudge = np.array([0.0, _NUDGE, 0.0])
    steeper, flatter = (rotation_period(ascending * (1.0 + sign * nudge), start) for sign in (1.0, -1.0))
    slope = (steeper - flatter)[np.isfinite(steeper - flatter)] / (2.0 * _NUDGE)
    periods = [cycles(time, spin[:, env, order[1]]) for env in range(spin.shape[1])]
    return [
        LawValues(
            f"{name}_momentum", f"change of the angular momentum of {name} in {whole:g} s, over it", "",
            tuple(map(float, turned)), none, step, "omega dt",
            (("mass", 0.0), ("angular damping", whole * float(along.mean()))),
            "", (("angular damping", math.inf if over else unevenness(along)),),
        ),
        LawValues(
            f"{name}_energy", f"energy of {name} gained in {whole:g} s, over it", "",
            tuple(map(float, gained)), none, step, "omega dt",
            (("mass", 0.0), ("angular damping", -2.0 * whole * float(lost.mean()))),
            "", (("angular damping", unevenness(lost)),),
        ),
        LawValues(
            f"{name}_period", f"period of the rotation of {name}", "s",
            tuple(period for period, _ in periods), tuple(map(float, predicted)),
            dt / fewest_periods(periods), "dt over the periods measured",
            (("mass", 0.0), ("middle moment", float(slope.mean()) if len(slope) else 0.0)),
            "no whole period was recorded", (("middle moment", unevenness(slope)),),
        ),
    ]  # fmt: skip


def _damped(begun: Array, ended: Array, gained: Array, tolerance: float) -> tuple[Array, Array]:
    """What a damping of c takes by the end, T seconds later, over c T: of the size of the error of the momentum, and,
    over 2 c T, of the energy, [env].

    begun, ended  angular momentum [env, 3]
    gained        energy over that of the start, minus 1
    tolerance     of the momentum

    A damping shortens the momentum along itself, so that the size of its error L - L0 grows by the cosine between the
    error and -L. An error far below the tolerance is nothing beside a change that shows: its direction says nothing.
    What drifts by a first-order method drifts by the share omega^2 dt in a second, so that a body that is damped, and
    slower by c T / 2 on average, drifts less: with the momentum r |L0| at the end, by -c T ln r.
    """
    sizes, error = np.linalg.norm(begun, axis=-1), ended - begun
    off = np.linalg.norm(error, axis=-1)
    kept = np.maximum(np.linalg.norm(ended, axis=-1) / sizes, _SMALL)
    energy = np.maximum(1.0 + gained, _SMALL)
    lost = energy * (1.0 + np.log(energy) / 2.0)
    if float((off / sizes).mean()) <= _SHARE * tolerance:
        return np.ones(len(off)), lost
    cosine = -np.divide((error * ended).sum(axis=-1), off * sizes, out=np.zeros(len(off)), where=off > 0.0)
    return cosine * (1.0 + np.log(kept)), lost


def _moments(recording: Recording, items: tuple[tuple[str, str], ...]) -> Array:
    """Principal moments of uniform boxes along their axes [kg m2], shape [body, 3]."""
    described = {checks.text(body, "name"): body for body in checks.objects(recording.scene, "bodies")}
    found = []
    for _, name in items:
        body = described.get(name, {})
        mass = checks.number(body, "mass", _SMALL, _LARGE)
        size = np.array(checks.vector(checks.mapping(body, "shape").get("size"), 3, "a box's size"))
        if not ((size >= _SMALL) & (size <= _LARGE)).all() or len(set(size.tolist())) < 3:
            raise DamagedRecording(f"{name} is no box of three unequal edges")
        found.append(mass / 12.0 * ((size**2).sum() - size**2))
    return np.array(found)
