"""Initial states from a file: a recording's states of one step, or arrays of the user's own."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.run.start import ITEMS
from gpusimbench.schemas import arrays, topics
from gpusimbench.schemas.blocks import STATE_HEAD_BYTES, decode_state, state_header, state_header_in
from gpusimbench.schemas.checks import Budget
from gpusimbench.schemas.errors import DamagedRecording, UsageError
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.mcap.contents import Message
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.provenance import SIMULATION, Simulation
from gpusimbench.schemas.treatment import Given

_ARCHIVE = b"PK"  # a zip file's first bytes
_FORMS = "a recording, FILE.mcap or FILE.mcap@STEP, or arrays by GROUP/FIELD, FILE.npz"


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
