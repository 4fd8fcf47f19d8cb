"""Recordings of given positions: real files, by the recorder's own sink, with an outcome known by construction."""

from __future__ import annotations

import json
import uuid
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recorder.capture.sink import Sink
from recorder.capture.states import StateWriter
from recorder.scenes.registry import make_scene
from schemas import topics
from schemas.configuration import RunConfiguration
from schemas.fields import StateField, body_field
from schemas.messages import message_class
from schemas.provenance import PROVENANCE, SCENE, SIMULATION, Provenance, Simulation


def cubes_field(dtype: str, *, frame: str = "world") -> StateField:
    """The position field of the 27 cubes."""
    names = make_scene("inclined-collision").groups()["cubes"]
    return replace(body_field("cubes", "position", dtype, names), frame=frame)


def write_recording(
    folder: Path,
    final: NDArray[Any],
    *,
    run: int = 0,
    simulator: str = "synthetic",
    steps: int = 5,
    dt: float = 1.0,
    status: str = "COMPLETE",
    reason: str = "",
    elapsed_s: float | None = 1.0,
    timed_steps: int = 1000,
    gpu_bytes: tuple[int, int] | None = None,
    origins: tuple[tuple[float, float, float], ...] = (),
    switches: dict[str, Any] | None = None,
    name: str | None = None,
    compression: str = "none",
    dropout: str = "",
    end: bool = True,
    stride: int = 1,
    change: Callable[[str, dict[str, Any]], Any] | None = None,
    field: StateField | None = None,
    environment: dict[str, str] | None = None,
    run_id: str | None = None,
) -> Path:
    """A recording whose cubes lie still until the last step and end at `final` [m], shape [env, 27, 3].

    elapsed_s  of the timed phase; None leaves it out
    gpu_bytes  baseline and peak on a GPU; None for a machine without
    change     called with the name and content of each JSON attachment; may change it in place, or return other text
    """
    n_env = len(final)
    field = field or cubes_field(str(final.dtype))
    configuration = RunConfiguration(
        simulator=simulator, scene="inclined-collision", n_env=n_env, dt=dt, steps=steps, run_index=run, warmup=0,
        timed_steps=timed_steps, phases=("timed", "capture") if elapsed_s else ("capture",), stride=stride,
    )  # fmt: skip
    gpus = ({"name": "Test GPU", "driver": "1"},) if gpu_bytes else ()
    provenance = Provenance(
        run_id or str(uuid.uuid4()),
        "2026-01-01T00:00:00Z",
        ("test",),
        configuration,
        gpus=gpus,
        host={"cpu": "test"},
        environment=environment or {},
    )
    scene = make_scene("inclined-collision")
    simulation = Simulation(
        version="1.0", device="Test GPU" if gpu_bytes else "cpu", options={}, switches=switches or {}, deviations=(),
        fields=(field,), scene={"name": scene.name, "sha256": scene.sha256(), "parameters": {}}, env_origins=origins,
    )  # fmt: skip
    path = folder / (name or f"{simulator}-{run}-{uuid.uuid4().hex[:8]}.mcap")
    sink = Sink(path, compression=compression)
    texts = {PROVENANCE: provenance.to_json(), SCENE: scene.to_json(), SIMULATION: simulation.to_json()}
    for attachment, text in texts.items():
        if change is not None:
            record = json.loads(text)
            changed = change(attachment, record)
            text = changed if isinstance(changed, str) else json.dumps(record)
        sink.attach(attachment, "application/json", text.encode())
    if elapsed_s:
        sink.channel(topics.timing("timed"), "gsb.v1.StepTiming")
        timing = message_class("gsb.v1.StepTiming")(
            first_step=0, steps_per_interval=timed_steps, start_ns=[0], end_ns=[round(elapsed_s * 1e9)]
        )
        sink.write(topics.timing("timed"), timing.SerializeToString())
    if gpu_bytes:
        topic = topics.gpu_memory(0, "device")
        sink.channel(topic, "gsb.v1.MemorySample")
        for used, phase, checkpoint in ((gpu_bytes[0], "baseline", "baseline"), (gpu_bytes[1], "timed", "")):
            sample = message_class("gsb.v1.MemorySample")(
                source=2, monotonic_ns=1, used_bytes=used, phase=phase, checkpoint=checkpoint
            )
            sink.write(topic, sample.SerializeToString())
    writer = StateWriter(sink, (field,), n_env=n_env, dt=dt, stride=stride)
    start = np.broadcast_to(np.array([b.position for b in scene.moving()[1:]], dtype=final.dtype), final.shape)
    writer.feed([start[np.newaxis]])
    writer.feed([np.stack([start] * (steps - 1) + [final])])
    writer.flush()
    if dropout:
        sink.channel(topics.RUN_DROPOUT, "gsb.v1.Dropout")
        lost = message_class("gsb.v1.Dropout")(topic="/state", first_step=1, steps=2, reason=dropout)
        sink.write(topics.RUN_DROPOUT, lost.SerializeToString())
    if not end:
        sink.abandon()
        return sink.partial
    return sink.finish(status, reason, last_step=steps, peak_rss_bytes=0)


def grid(n_env: int, dtype: str = "float64") -> NDArray[Any]:
    """27 well separated positions on the board [m], the same in every environment, [env, 27, 3]."""
    x, y = np.meshgrid(np.linspace(0.1, 0.5, 9), np.array([-0.1, 0.0, 0.1]))
    one = np.column_stack([x.ravel(), y.ravel(), np.full(27, 0.03)])
    return np.broadcast_to(one, (n_env, 27, 3)).astype(dtype).copy()


def metrics_of(text: str, label: int = 0) -> dict[str, Any]:
    """The metrics of one group of a JSON result."""
    found: dict[str, Any] = json.loads(text)["groups"][label]["metrics"]
    return found
