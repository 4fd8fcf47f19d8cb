"""gsb-record --sim real --scene cube-toss: measured motions as a recording, which simulations are compared with."""

from __future__ import annotations

import argparse
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.plan import prepare_folder, release, reserve, utc_now
from gpusimbench.recorder.probes.software import describe_software
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.sets.progress import say
from gpusimbench.recorder.trials.tosses import VARIABLE, Tosses, read_tosses
from gpusimbench.schemas import topics
from gpusimbench.schemas.blocks import state_parts
from gpusimbench.schemas.configuration import RunConfiguration, sim_time_ns
from gpusimbench.schemas.errors import DataLost, UsageError
from gpusimbench.schemas.fields import StateField, body_fields
from gpusimbench.schemas.provenance import PROVENANCE, REAL, SCENE, SIMULATION, Provenance, Simulation
from gpusimbench.schemas.tosses import GROUP, TOSSES

_BLOCK = 50  # rows of a message, the most that the format allows
_NOTES = {
    "linear_velocity": "as measured: the mean over the interval before the row, smoothed by its authors",
    "angular_velocity": "measured in the body's frame",
}


def record_tosses(arguments: argparse.Namespace, argv: tuple[str, ...], scene: Scene) -> Path:
    """Write the recording of a set of tosses; returns its path."""
    for name in ("trials", "unit", "sample_time"):
        if getattr(arguments, name) is not None:
            raise UsageError(
                f"--{name.replace('_', '-')} is for positions from a CSV file; scene {scene.name} has --tosses"
            )
    tosses = read_tosses(arguments.tosses)
    configuration = RunConfiguration(
        simulator=REAL,
        scene=scene.name,
        n_env=len(tosses),
        dt=scene.dt,
        steps=tosses.steps(scene),
        warmup=0,
        timed_steps=0,
        phases=("capture",),
        compression=arguments.compression,
    )
    with new_recording(arguments.out, configuration, argv) as (sink, provenance):
        _write(sink, configuration, provenance, tosses, scene)
    say(f"{len(tosses)} tosses: {tosses.known.source}")
    if not tosses.synthetic and not tosses.notice:
        say("no LICENSE lies beside the tosses: it has to travel with every copy of the data, this recording too")
    if tosses.synthetic and arguments.tosses is None:
        say(f"these are not measured; --tosses PATH, or {VARIABLE}, names the measured set (docs/how-to/cube-toss.md)")
    return sink.path


@contextmanager
def new_recording(
    out: Path, configuration: RunConfiguration, argv: tuple[str, ...]
) -> Iterator[tuple[Sink, Provenance]]:
    """A recording of trials that is being written; on an error nothing remains, but for data that was lost."""
    prepare_folder(out)
    created = utc_now()
    provenance = Provenance(str(uuid.uuid4()), created, argv, configuration, software=describe_software())
    path = reserve(out, configuration, created)
    try:
        sink = Sink(path, compression=configuration.compression, reserved=True)
        try:
            yield sink, provenance
        except BaseException as error:
            sink.abandon()
            if not isinstance(error, DataLost):
                sink.partial.unlink(missing_ok=True)
            raise
    finally:
        release(path)


def _write(
    sink: Sink, configuration: RunConfiguration, provenance: Provenance, tosses: Tosses, scene: Scene
) -> None:  # fmt: skip
    fields = body_fields({GROUP: scene.groups()[GROUP]}, "float64", _NOTES)
    simulation = Simulation(
        version="measured",
        device="real",
        options={},
        switches={},
        deviations=(),
        fields=fields,
        scene={"name": scene.name, "sha256": scene.sha256(), "parameters": scene.parameters},
        fresh_start="each toss was thrown anew",
    )
    sink.attach(PROVENANCE, "application/json", provenance.to_json().encode())
    sink.attach(SCENE, "application/json", scene.to_json().encode())
    sink.attach(SIMULATION, "application/json", simulation.to_json().encode())
    sink.attach(TOSSES, "application/json", tosses.known.to_json().encode())
    if tosses.notice:
        sink.attach("LICENSE", "text/plain", tosses.notice.encode())
    rows = tosses.fields()
    for field in fields:
        _write_field(
            sink, configuration, field, tosses.side_by_side(rows[field.field], configuration.steps)[:, :, np.newaxis]
        )
    sink.finish("COMPLETE", "", last_step=configuration.steps, peak_rss_bytes=0)


def _write_field(sink: Sink, configuration: RunConfiguration, field: StateField, rows: NDArray[np.float64]) -> None:
    topic = topics.state(field.group, field.field, 0)
    sink.channel(topic, "gsb.v1.StateBlock", field.to_metadata())
    for first in range(0, len(rows), _BLOCK):
        block = np.ascontiguousarray(rows[first : first + _BLOCK])
        time = sim_time_ns(first, configuration.dt)
        sink.digest.state(field, configuration.n_env, block)
        sink.write_parts(
            topic, state_parts(block, first_step=first, stride=1, env_start=0, sim_time_ns=time), sim_ns=time
        )
