"""Descriptors, provenance and digests: what shared files rely on for years."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench import schemas
from gpusimbench.schemas.build_descriptors import build
from gpusimbench.schemas.configuration import RunConfiguration, sim_time_ns
from gpusimbench.schemas.digest import ContentDigest, content_hash
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.fields import BODY_FIELDS, body_field
from gpusimbench.schemas.messages import DESCRIPTOR_SETS, embedded_schema
from gpusimbench.schemas.provenance import Deviation, Provenance, ReplayOf, Simulation
from gpusimbench.schemas.topics import StateTopic, parse_state, state

_FIELDS = tuple(body_field("cubes", name, "float64", ("a", "b")) for name in BODY_FIELDS)
# Numbers of fields never change once a file was shared; see the evolution rules in schemas/README.md.
_WIRE = {
    "StateBlock": {
        "first_step": 1, "steps": 2, "stride": 3, "env_start": 4, "envs": 5, "items": 6, "width": 7,
        "sim_time_ns": 8, "encoding": 9, "crc32": 10, "packed": 11, "data": 12, "data64": 13, "word_bytes": 14,
    },
    "ActionBlock": {
        "first_step": 1, "steps": 2, "stride": 3, "env_start": 4, "envs": 5, "width": 6, "sim_time_ns": 7,
        "crc32": 8, "data": 9, "data64": 10, "encoding": 11, "stream_env": 12, "stream_begun": 13,
    },
    "StepTiming": {"first_step": 1, "steps_per_interval": 2, "start_ns": 3, "end_ns": 4},
    "MemorySample": {
        "source": 1, "device": 2, "monotonic_ns": 3, "used_bytes": 4, "total_bytes": 5, "phase": 6, "checkpoint": 7,
        "other_processes": 8, "other_bytes": 9, "reserved_bytes": 10,
    },
    "HardwareSample": {
        "device": 1, "monotonic_ns": 2, "phase": 3, "sm_clock_mhz": 4, "memory_clock_mhz": 5, "power_mw": 6,
        "temperature_c": 7, "throttle_reasons": 8, "utilisation_percent": 9, "other_processes": 10,
        "cpu_clock_mhz": 11, "other_cpus": 12, "not_known": 13,
    },
    "Event": {"kind": 1, "phase": 2, "monotonic_ns": 3, "unix_ns": 4, "text": 5},
    "FingerprintBlock": {"first_step": 1, "steps": 2, "stride": 3, "env_start": 4, "envs": 5, "hashes": 6},
    "ArrayHashes": {"update": 1, "order": 2, "states": 3, "arrays": 4, "hashes": 5},
    "StepCounts": {"first_step": 1, "stride": 2, "mean": 3, "p95": 4, "max": 5},
    "Overflow": {"first_step": 1, "stride": 2, "bits": 3, "envs": 4},
    "ActionStream": {
        "generator": 1, "first_step": 2, "steps": 3, "envs": 4, "first_sha256": 5, "last_sha256": 6, "verified": 7,
    },
    "Dropout": {"topic": 1, "first_step": 2, "steps": 3, "reason": 4},
    "EnvFailure": {
        "env": 1, "step": 2, "kind": 3, "group": 4, "field": 5, "item": 6, "component": 7, "value": 8,
        "overflow_bits": 9, "first_step": 10, "steps": 11,
    },
    "FailingEnvs": {"failures": 1, "not_finite": 2, "overflow": 3, "out_of_bounds": 4, "last_step": 5},
    "RunEnd": {
        "status": 1, "reason": 2, "last_step": 3, "digests": 4, "content_hash": 5, "peak_rss_bytes": 6, "cause": 7,
    },
}  # fmt: skip


def _configuration(**changes: Any) -> RunConfiguration:
    return RunConfiguration(**{"simulator": "s", "scene": "c", "n_env": 2, "dt": 0.01, "steps": 5, **changes})


def test_descriptor_set_is_current(tmp_path: Path) -> None:
    """Hold the descriptor set to its .proto files; make proto rebuilds it."""

    def described(data: bytes) -> Any:
        files = descriptor_pb2.FileDescriptorSet.FromString(data).file
        for file in files:
            file.ClearField("source_code_info")  # its layout may differ between versions of protoc
        return {file.name: file for file in files}

    build(tmp_path / "new.binpb")
    kept = (Path(schemas.__file__).parent / DESCRIPTOR_SETS["gsb"]).read_bytes()
    assert described((tmp_path / "new.binpb").read_bytes()) == described(kept)


def _message_names() -> list[str]:
    data = (Path(schemas.__file__).parent / DESCRIPTOR_SETS["gsb"]).read_bytes()
    files = descriptor_pb2.FileDescriptorSet.FromString(data).file
    return [f"{file.package}.{message.name}" for file in files for message in file.message_type]


@pytest.mark.parametrize("name", _message_names())
def test_field_numbers_never_change(name: str) -> None:
    """Keep the wire format that shared files have."""
    (file,) = descriptor_pb2.FileDescriptorSet.FromString(embedded_schema(name)).file
    message = next(m for m in file.message_type if f"gsb.v1.{m.name}" == name)
    found = {field.name: field.number for field in message.field}
    expected = _WIRE[message.name]
    assert {k: found.get(k) for k in expected} == expected
    assert not file.dependency, "an embedded schema is complete in itself"


def test_comments_travel_with_the_schema() -> None:
    """Carry the .proto's comments in every recording."""
    (file,) = descriptor_pb2.FileDescriptorSet.FromString(embedded_schema("gsb.v1.StateBlock")).file
    assert any("[steps, envs, items, width]" in loc.leading_comments for loc in file.source_code_info.location)


@pytest.mark.parametrize(
    "replay_of", [None, ReplayOf("first", "hash"), ReplayOf("first", "hash", {"engine.cone": "x"})]
)
def test_provenance_round_trip(replay_of: ReplayOf | None) -> None:
    """Return what was written, and ignore keys of a later version."""
    provenance = Provenance(
        "id", "2026-01-01T00:00:00Z", ("gsb-record", "--sim"), _configuration(options={"cone": "elliptic"}),
        host={"cpu": "Modèle x"}, gpus=({"name": "g"},), software={"python": "3"}, environment={"XLA_FLAGS": "-x"},
        replay_of=replay_of,
    )  # fmt: skip
    text = provenance.to_json()
    assert Provenance.from_json(text) == provenance
    assert text == json.dumps(json.loads(text), indent=1, sort_keys=True, ensure_ascii=False) + "\n"
    assert "Modèle" in text
    later = {**json.loads(provenance.to_json()), "added_later": 1}
    later["configuration"]["added_later"] = [2]
    assert Provenance.from_json(json.dumps(later)) == provenance


def test_simulation_round_trip() -> None:
    """Return what was written of the built simulator."""
    simulation = Simulation(
        version="4.0", device="cpu", options={"iterations": 100}, switches={"precision": "float64"},
        deviations=(Deviation("a", "1", "2", "because"),), fields=_FIELDS, scene={"name": "c"},
        env_origins=((0.0, 1.0, 2.0),), timing_covers="all", fresh_start="rebuilt",
    )  # fmt: skip
    assert Simulation.from_json(simulation.to_json()) == simulation


@given(
    origins=st.lists(st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 3), max_size=4).map(tuple),
    numbers=st.lists(st.integers() | st.none() | st.booleans(), max_size=4),
    word=st.text() | st.just("[\n 1,\n 2,\n 3\n]"),
)
def test_origins_are_a_line_each(
    origins: tuple[tuple[float, float, float], ...], numbers: list[int | bool | None], word: str
) -> None:
    """Write each origin on one line, and the same values as json.dumps."""
    simulation = Simulation(
        version=word, device="cpu", options={"numbers": numbers, "words": [word] * 3}, switches={}, deviations=(),
        fields=_FIELDS, scene={}, env_origins=origins,
    )  # fmt: skip
    text = simulation.to_json()
    plain = json.dumps(dataclasses.asdict(simulation))
    assert json.dumps(json.loads(text), sort_keys=True) == json.dumps(json.loads(plain), sort_keys=True)
    lines = text.splitlines()
    assert all(f"  [{x!r}, {y!r}, {z!r}]" in (line.rstrip(",") for line in lines) for x, y, z in origins)


def test_many_origins_are_small() -> None:
    """Take 24 bytes an environment at most on a grid of 64 x 64, where three lines took 35."""
    grid = tuple((4.0 * (env % 64), 4.0 * (env // 64), 0.0) for env in range(4096))
    sizes = [
        len(
            Simulation(
                version="1", device="cpu", options={}, switches={}, deviations=(), fields=_FIELDS, scene={},
                env_origins=origins,
            ).to_json()
        )
        for origins in ((), grid)
    ]  # fmt: skip
    assert (sizes[1] - sizes[0]) / len(grid) <= 24


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda fields: fields[0].update(items=[]), "no items or no components"),
        (lambda fields: fields[0].update(components=[]), "no items or no components"),
        (lambda fields: fields.append(fields[0]), "a state field is there twice"),
        (lambda fields: fields.extend([fields[0]] * 256), "more than the"),
    ],
)
def test_state_fields_that_hold_nothing(change: Callable[[list[dict[str, Any]]], object], said: str) -> None:
    """Refuse a field without items or without components, one that is there twice, and more than are read."""
    simulation = Simulation(
        version="4.0", device="cpu", options={}, switches={}, deviations=(), fields=_FIELDS, scene={}
    )
    record = json.loads(simulation.to_json())
    change(record["fields"])
    with pytest.raises(DamagedRecording, match=said):
        Simulation.from_json(json.dumps(record))


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", "null", '{"run_id": 1}', '{"run_id":"a","created_utc":"b","argv":3,"configuration":{}}']
)
def test_unreadable_provenance_is_damage(text: str) -> None:
    """Raise DamagedRecording on provenance that says nothing."""
    for kind in (Provenance, Simulation):
        with pytest.raises(DamagedRecording):
            kind.from_json(text)


@given(st.dictionaries(st.sampled_from(["n_env", "dt", "steps", "stride", "phases"]), st.none() | st.text(max_size=3)))
def test_configuration_of_wrong_kinds_is_damage(changes: dict[str, Any]) -> None:
    """Raise DamagedRecording, never anything else, on a configuration of wrong types."""
    record = {**_configuration().to_json(), **changes}
    try:
        RunConfiguration.from_json(record)
    except DamagedRecording:
        return
    assert set(changes) <= {"phases"}


@given(st.integers(1, 60), st.lists(st.integers(1, 59), max_size=5))
def test_digest_ignores_how_rows_are_split(rows: int, cuts: list[int]) -> None:
    """Give the same digest however the rows were split into blocks."""
    array = np.random.default_rng(rows).standard_normal((rows, 2, 2, 3))
    whole, parts = ContentDigest(), ContentDigest()
    whole.state(_FIELDS[0], 2, array)
    for part in np.split(array, sorted({c for c in cuts if c < rows})):
        parts.state(_FIELDS[0], 2, part)
    assert whole.digests() == parts.digests()


def test_content_hash_covers_everything() -> None:
    """Change with any stream, any attachment and the way the run ended."""
    base = {"state cubes/position": "aa", "attachment scene.json": "bb"}
    hashes = {
        content_hash(base, "complete", ""),
        content_hash({**base, "attachment scene.json": "bc"}, "complete", ""),
        content_hash({**base, "more": ""}, "complete", ""),
        content_hash(base, "invalid", ""),
        content_hash(base, "complete", "why"),
    }
    assert len(hashes) == 5
    assert content_hash(dict(reversed(base.items())), "complete", "") in hashes


def test_state_topics() -> None:
    """Write and read the names that others rely on."""
    assert state("cubes", "position", 64) == "/state/cubes/position/000064"
    assert parse_state("/state/cubes/position/000064") == StateTopic("cubes", "position", 64)
    assert parse_state("/state/cubes/position") is None
    assert parse_state("/statex/cubes/position/0") is None


@given(st.integers(0, 10**7), st.sampled_from([0.01, 0.002, 1 / 3, 1e-4, 0.005]))
def test_times_name_steps(step: int, dt: float) -> None:
    """Recover a step from its simulated time in nanoseconds."""
    assert round(sim_time_ns(step, dt) / (dt * 1e9)) == step


def test_a_reason_cannot_pass_for_streams() -> None:
    """Tell a stream from a reason that spells its line, and both from any other."""
    honest = content_hash({"a": "1", "b": "2"}, "complete", "")
    assert content_hash({"a": "1"}, "complete", "\nb 2") != honest
    assert content_hash({"a 1\nb": "2"}, "complete", "") != honest
    assert content_hash({"a": "1"}, "complete", "x\ny") != content_hash({"a": "1"}, "complete", "x\\ny")


def test_one_line_is_as_it_was() -> None:
    """Keep the identity of recordings whose texts have one line, backslashes too."""
    import hashlib

    lines = sorted(["status failed\n", "reason C:\\new\n", "a 1\n"])
    assert content_hash({"a": "1"}, "failed", "C:\\new") == hashlib.sha256("".join(lines).encode()).hexdigest()
