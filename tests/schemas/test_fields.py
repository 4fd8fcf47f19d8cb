"""Units of state fields whose items differ in them."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from gpusimbench.recorder.log import RecordingWriter
from gpusimbench.schemas.errors import DamagedRecording, UsageError
from gpusimbench.schemas.fields import StateField, ball_fields, body_field, joint_field
from tests.reading import verified


@pytest.mark.parametrize(
    ("slides", "units", "components"),
    [
        ((), {"qpos": ("rad", "rad"), "qvel": ("rad/s", "rad/s")}, ("angle",)),
        (("rail", "hinge"), {"qpos": ("m", "m"), "qvel": ("m/s", "m/s")}, ("coordinate",)),
        (("rail",), {"qpos": ("m", "rad"), "qvel": ("m/s", "rad/s")}, ("coordinate",)),
    ],
)
def test_joints_have_their_units(
    slides: tuple[str, ...], units: dict[str, tuple[str, ...]], components: tuple[str, ...]
) -> None:
    """Make joint fields of slides and hinges, and read them back from JSON with a unit an item."""
    for name, expected in units.items():
        field = joint_field("joints", name, "float64", ("rail", "hinge"), slides=slides)
        assert (field.units, field.components, field.frame) == (expected, components, "joint")
        assert bool(field.item_units) == (len(set(expected)) > 1)
        assert field.unit in (expected[0], "m or rad", "m/s or rad/s")
        assert StateField.from_json(json.loads(json.dumps(asdict(field)))) == field
        assert field.to_metadata().get("item_units", "") == ",".join(field.item_units)


def test_older_files_have_one_unit() -> None:
    """Read a field without the key, as all files before it, and refuse a list of another length."""
    told = asdict(body_field("bodies", "position", "float32", ("a", "b")))
    del told["item_units"]
    assert StateField.from_json(json.loads(json.dumps(told))).units == ("m", "m")
    told["item_units"] = ["m"]
    with pytest.raises(DamagedRecording, match="1 units, and there are 2 items"):
        StateField.from_json(json.loads(json.dumps(told)))


def test_a_recording_keeps_the_units(tmp_path: Path) -> None:
    """Log joints of two units and a ball joint, and find the units in the recording."""
    fields = (
        joint_field("joints", "qpos", "float64", ("rail", "hinge"), slides=("rail",)),
        *ball_fields("balls", "float64", ("hip",)),
    )
    path = tmp_path / "a.mcap"
    with RecordingWriter(
        path, simulator="mine", version="1", scene="cart", n_env=2, dt=0.1, steps=1, fields=fields
    ) as log:
        log.append(*(np.zeros((2, 2, len(field.items), field.width)) for field in fields))
    recording = verified(path)
    assert recording.fields == fields
    assert recording.fields[0].units == ("m", "rad")
    assert {field.frame for field in recording.fields} == {"joint"}


def test_a_field_that_no_body_has() -> None:
    """Name the fields that bodies have."""
    with pytest.raises(UsageError, match="'quaternion' is no field of bodies; these are: position, orientation"):
        body_field("cubes", "quaternion", "float64", ("a",))
