"""What a run begins with: the scene's first state, positions and velocities that are drawn or come from a file, or a
snapshot."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.run import draws
from gpusimbench.recorder.run.draws import GRID
from gpusimbench.recorder.scenes.base import Body, Scene
from gpusimbench.recorder.simulators.base import Description, Simulator, States
from gpusimbench.recorder.simulators.snapshot import Extent, Snapshot
from gpusimbench.schemas import arrays, topics
from gpusimbench.schemas.blocks import STATE_HEAD_BYTES, decode_state, state_header, state_header_in
from gpusimbench.schemas.checks import Budget
from gpusimbench.schemas.errors import DamagedRecording, UsageError
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.initial import GIVEN, INITIAL_KINDS, MOST_SPREAD, Given, Initial, parse_initial
from gpusimbench.schemas.mcap.contents import Message
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.provenance import SIMULATION, Simulation
from gpusimbench.schemas.symmetry import Symmetry, symmetry_of
from gpusimbench.schemas.tosses import NOTICE
from gpusimbench.schemas.treatment import TEACHER

ITEMS = "items"
"""Of given states: GROUP/items has the names of a group's bodies or joints, in the order of its arrays."""

Arrays = Mapping[str, NDArray[Any]]

_STREAM = 0x494E4954  # tells these words from those of actions, which the same seed draws
_TURNS = 0x5455524E  # the same of the words of orientations
_TRIES = 32  # pairs, of which 1 in 4.7 lies outside the circle
_ARCHIVE = b"PK"  # a zip file's first bytes
_FORMS = "a recording, FILE.mcap or FILE.mcap@STEP, or arrays by GROUP/FIELD, FILE.npz"


def begin(simulator: Simulator, description: Description, text: str, given: bytes | None) -> None:
    """Give a simulator that was just built the state that a run was asked to begin with.

    text   as RunConfiguration.initial
    given  the attachment of that, for what was not drawn

    UsageError where what was given does not fit the simulator.
    """
    if not text:
        return
    how = parse_initial(text)
    if not isinstance(how, Given):
        first = tuple(np.array(array) for array in simulator.state())
        states = drawn_states(how, simulator.scene, description.fields, first, simulator.seed)
        if symmetry := symmetry_of(how, json.loads(simulator.scene.to_json())):
            states = images(states, symmetry, description.fields, description.env_origins)
        simulator.set_state(states)
        return
    if given is None:
        raise UsageError(f"the run begins with states that were given ({text}), and they are not there")
    found = arrays.decode(GIVEN, given)
    if how.step is None:
        simulator.set_state(states_of(found, simulator, description))
    else:
        simulator.restore(_snapshot_of(found, how.step, simulator))


def states_of(given: Arrays, simulator: Simulator, description: Description) -> States:
    """Given positions and velocities as arrays [env, item, width] of the simulator's fields; what was not given is that
    of the scene's first state. UsageError where something does not fit."""
    names = {field.name for field in description.fields}
    items = {name for name in given if name.endswith(f"/{ITEMS}") or name.startswith(TEACHER)}
    if unknown := sorted(given.keys() - names - items - {NOTICE}):
        raise UsageError(f"initial states have '{unknown[0]}', and the simulator's are {', '.join(sorted(names))}")
    found = []
    for layout, present in zip(description.fields, simulator.state(), strict=True):
        if layout.name not in given:
            found.append(np.array(present))
            continue
        wanted = _ordered(layout, given)
        shape = (simulator.n_env, *present.shape[1:])
        if wanted.shape[1:] != shape[1:] or len(wanted) not in (1, simulator.n_env):
            raise UsageError(
                f"initial states of {layout.name} have the shape {wanted.shape}, not {shape} as environment, item, "
                "component, or 1 environment for all"
            )
        values = np.broadcast_to(wanted.astype(np.float64), shape)
        if layout.field == "position" and layout.frame == "world" and description.env_origins:
            values = values + np.array(description.env_origins)[:, np.newaxis]
        found.append(np.ascontiguousarray(values, dtype=present.dtype))
    return tuple(found)


def _ordered(layout: StateField, given: Arrays) -> NDArray[Any]:
    names = given.get(f"{layout.group}/{ITEMS}")
    array = given[layout.name]
    if names is None or array.ndim != 3 or array.shape[1] != names.size:
        return array
    at = {str(name): index for index, name in enumerate(names.ravel())}
    if missing := [item for item in layout.items if item not in at]:
        raise UsageError(f"initial states have no {layout.group} '{missing[0]}'; they have {', '.join(at)}")
    return array[:, [at[item] for item in layout.items]]


def _snapshot_of(given: Arrays, step: int, simulator: Simulator) -> Snapshot:
    # an engine may use numbers of a snapshot as indices: at least their arrays are like its own
    own = simulator.snapshot().arrays
    for name in sorted(own.keys() | given.keys()):
        mine, theirs = (
            f"{a[name].dtype} {a[name].shape}" if name in a else "nothing of that name" for a in (own, given)
        )
        if mine != theirs:
            raise UsageError(
                f"the snapshot is of another engine, version or configuration: of '{name}' it has {theirs}, and the "
                f"simulator has {mine}"
            )
    return Snapshot(step, {name: np.array(given[name]) for name in own})


def saved(simulator: Simulator) -> bytes:
    """The present state of a simulator, as the attachment of a snapshot."""
    return arrays.encode(simulator.snapshot().arrays)


def refusal(name: str, adapter: type[Simulator], options: object, text: str, snapshots: tuple[int, ...]) -> str:
    """Why a simulator cannot begin so, or save its state; empty where it can."""
    claims = adapter.state_claims(options)
    how = parse_initial(text) if text else None
    continues = isinstance(how, Given) and how.step is not None
    if how and not continues and claims.set_state.extent is Extent.NONE:
        return f"simulator '{name}' has no initial states per environment (--initial): {claims.set_state.why}"
    if (continues or snapshots) and claims.snapshot.extent is Extent.NONE:
        asked = "--from" if continues else "--snapshot"
        return f"simulator '{name}' cannot save and restore its state ({asked}): {claims.snapshot.why}"
    return ""


def drawn_states(
    initial: Initial, scene: Scene, fields: tuple[StateField, ...], first: States, seed: int
) -> tuple[NDArray[np.floating], ...]:
    """The first state [env, item, width] of each field, in its precision, with what is drawn for it added.

    Added is, uniformly within +- spread and independently for each environment:

        to the linear velocity of every free body, along each axis, or along the one that the body is launched along, by
        the first of the three draws [m/s]
        to the angular velocity of the free bodies that say so, times the body's share for each axis [rad/s]
        to the angle of every joint [rad], times the joint's share where the robot has any, kept within its limits

    Of a robot whose links close a loop, only the crank's angle is drawn so, and its speed [rad/s]; the other joints
    follow, so that the loop begins closed (``recorder.scenes.loop``), to the last bit of the machine's sine and cosine.

    Bodies that say so get an orientation instead, uniform over all rotations (``orientations``). No body is moved, so
    that none penetrates another.
    """
    found, limits = [], scene.joint_limits()
    linkage = scene.robot.four_bar() if scene.robot is not None else None
    angles = np.empty(0)  # of the loop, which come before its speeds
    bodies = {(body.group, body.name): body for body in scene.moving()}
    for place, (layout, array) in enumerate(zip(fields, first, strict=True)):
        here = [bodies.get((layout.group, name)) for name in layout.items]
        if layout.field == "orientation":
            turned = np.array([body is not None and bool(body.turned) for body in here])[:, None]
            given = orientations(initial, seed, place, array.shape[:2]) if turned.any() else array
            found.append(np.where(turned, given, array).astype(array.dtype))
            continue
        drawn = draw(initial, seed, place, array.shape)
        if layout.field == "qpos" and scene.robot is not None and scene.robot.drawn is not None:
            drawn *= np.array(scene.robot.drawn)[:, None]
        if linkage is not None and layout.field in ("qpos", "qvel"):
            crank = array[:, 0, 0].astype(np.float64) + drawn[:, 0, 0]
            if layout.field == "qpos":
                angles = closed = linkage.angles(crank)
            else:
                closed = linkage.speeds(angles, crank)
            found.append(closed[..., None].astype(array.dtype))
            continue
        added = _added(layout.field, here, drawn)
        if added is None:
            found.append(array.copy())
            continue
        given = array + added.astype(array.dtype)
        if layout.field == "qpos" and layout.group in limits:
            bounds = np.array(limits[layout.group], dtype=array.dtype)
            given = np.clip(given, bounds[:, :1], bounds[:, 1:])
        found.append(given.astype(array.dtype))
    return tuple(found)


def _added(field: str, bodies: Sequence[Body | None], drawn: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """What is added of the drawn numbers [env, item, width] to a field of these bodies; None where it stays."""
    if field == "qpos":
        return drawn
    if field == "linear_velocity":
        for item, body in enumerate(bodies):
            if body is not None and body.launch is not None:
                drawn[:, item] = drawn[:, item, :1] * np.array(body.launch)
        return drawn
    if field == "angular_velocity" and any(body is not None and body.spin for body in bodies):
        return np.asarray(drawn * np.array([(body and body.spin) or (0.0, 0.0, 0.0) for body in bodies]))
    return None


def images(
    states: States, symmetry: Symmetry, fields: Sequence[StateField], origins: Sequence[tuple[float, float, float]]
) -> tuple[NDArray[np.floating], ...]:
    """The images of states [env, item, width] of these fields, by a symmetry about the origin of each environment.

    origins  of the environments [m]; empty where all are at zero
    """
    places = np.array(origins).reshape(-1, 1, 3)
    moved = places - symmetry.point(places)  # of the image of the world's origin, in the world
    found = []
    for layout, array in zip(fields, states, strict=True):
        image = symmetry.image(layout, array)
        in_world = layout.field == "position" and layout.frame == "world"
        found.append((image + moved).astype(array.dtype) if in_world and moved.any() else image)
    return tuple(found)


def orientations(initial: Initial, seed: int, field: int, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Unit quaternions wxyz, uniform over all rotations, of this shape [env, item] and 4, the same on every machine.

    Of two points a and b in the unit circle, the quaternion is (a, b sqrt((1 - |a|^2) / |b|^2)) (Marsaglia, "Choosing a
    point from the surface of a sphere", 1972). Each is the first of 32 points, drawn in the square around the circle.
    """
    pairs = draws.draw(initial, 1.0, seed=seed, stream=_TURNS, field=field, shape=(*shape, 2, _TRIES, 2))
    squared = (pairs**2).sum(axis=-1)
    first = ((squared < 1.0) & (squared > 0.0)).argmax(axis=-1)[..., None]
    points = np.take_along_axis(pairs, first[..., None], axis=-2)[..., 0, :]
    one, other = np.moveaxis(np.take_along_axis(squared, first, axis=-1), -2, 0)
    return np.concatenate([points[..., 0, :], points[..., 1, :] * np.sqrt((1.0 - one) / other)], axis=-1)


def draw(initial: Initial, seed: int, field: int, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """What is added to a field of this shape [env, item, width], the `field`-th of the layout: drawn as
    ``recorder.run.draws`` says, with the stream 0x494E4954."""
    return draws.draw(initial, initial.spread, seed=seed, stream=_STREAM, field=field, shape=shape)


def parse(text: str, n_env: int, scene: Scene, vary: str = "") -> str:
    """What --initial says of drawn states, as the recording keeps it. UsageError where nothing can be drawn so.

    vary  parameters that vary, as of a RunConfiguration
    """
    try:
        drawn = Initial.parse(text)
        if drawn.spread < GRID or (drawn.but or 0) >= n_env:
            raise ValueError(text)
    except ValueError:
        ends = " or ".join(f",{kind.name}:{kind.value}" for kind in INITIAL_KINDS.values())
        raise UsageError(
            f"--initial is random:SPREAD, with a spread from {GRID!r} to {MOST_SPREAD:g} (of velocities in m/s, of "
            f"joint angles in rad), and may end with {ends}, with E an environment, AXES x, y or xy, and ORDER "
            f"reverse, not '{text}'"
        ) from None
    symmetry = symmetry_of(drawn, json.loads(scene.to_json()), vary)
    if symmetry is not None and symmetry.why_not:
        raise UsageError(f"--initial {text}: scene '{scene.name}' {symmetry.why_not}")
    return str(drawn)


def read_given(text: str, n_env: int) -> tuple[str, bytes]:
    """Initial states from the file that --initial names: how the run's configuration calls them, and the attachment.

    Positions are relative to the origins of their environments. UsageError where there is no such file or step, or
    where it has not the states of 1 or `n_env` environments; DamagedRecording where it cannot be read.
    """
    path, step = _place(text)
    try:
        found = _of_archive(path) if _is_archive(path) else _of_recording(path, step)
    except OSError as error:
        raise UsageError(f"--initial {text}: {error.strerror or error}; it takes {_FORMS}, or random:SPREAD") from None
    for name, array in found.items():
        if name.endswith(f"/{ITEMS}"):
            continue
        if array.ndim != 3 or len(array) not in (1, n_env):
            raise UsageError(
                f"--initial {text}: {name} has the shape {array.shape}; it is [environment, item, component], of 1 "
                f"environment or of {n_env}, as --n-env says"
            )
        if array.dtype.kind not in "iuf" or not np.isfinite(array).all():
            raise UsageError(f"--initial {text}: {name} is not all finite numbers")
    if not found:
        raise UsageError(f"--initial {text}: the file has no states")
    data = arrays.encode(found)
    return str(Given(hashlib.sha256(data).hexdigest())), data


def _place(text: str) -> tuple[Path, int | None]:
    name, at, step = text.rpartition("@")
    if at and step.isdigit() and not Path(text).exists():
        return Path(name), int(step)
    return Path(text), None


def _is_archive(path: Path) -> bool:
    with path.open("rb") as stream:
        return stream.read(len(_ARCHIVE)) == _ARCHIVE


def _of_archive(path: Path) -> dict[str, NDArray[Any]]:
    return arrays.decode(str(path), path.read_bytes())


def _of_recording(path: Path, step: int | None) -> dict[str, NDArray[Any]]:
    container = Container(path)
    described = container.attachment(SIMULATION)
    if described is None:
        raise DamagedRecording(f"{path} does not say what its simulator was")
    simulation = Simulation.from_json(described, Budget())
    found: dict[str, NDArray[Any]] = {}
    for field in simulation.fields:
        array = _state_at(container, field, step)
        if field.field == "position" and field.frame == "world" and simulation.env_origins:
            array = array - np.array(simulation.env_origins)[:, np.newaxis]
        found[field.name] = array
        found[f"{field.group}/{ITEMS}"] = np.array(field.items)
    return found


def _state_at(container: Container, field: StateField, step: int | None) -> NDArray[Any]:
    """A field's array [env, item, width] after a step; of the first that was recorded where none is given."""
    places = topics.states_of(container.channels, field.group, field.field)
    parts = [_row(container, container.messages(topic), step) for topic in sorted(places, key=places.__getitem__)]
    if not parts or any(part is None for part in parts):
        raise UsageError(f"{container.path} has no states of step {0 if step is None else step}")
    return np.concatenate([part for part in parts if part is not None])


def _row(container: Container, messages: list[Message], step: int | None) -> NDArray[Any] | None:
    for message in messages:
        size, head = container.peek(message, STATE_HEAD_BYTES)
        header = state_header_in(head, size) or state_header(container.read(message)[1])
        steps = range(header.first_step, header.first_step + header.steps * header.stride, max(header.stride, 1))
        if step is None or step in steps:
            array = decode_state(container.read(message)[1])[1]
            row: NDArray[Any] = array[0 if step is None else steps.index(step)]
            return row
    return None
