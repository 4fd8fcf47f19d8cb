"""A short run, recorded as gsb-record does it and read back."""

from __future__ import annotations

import hashlib

import numpy as np

from gpusimbench.recorder.conformance.checks.agreement import expect_repeatable
from gpusimbench.recorder.conformance.subject import Subject
from gpusimbench.recorder.conformance.trajectory import RecordedRun
from gpusimbench.recorder.conformance.verdict import NotApplicable, expect, fail
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.schemas import topics
from gpusimbench.schemas.blocks import decode_fingerprints, decode_state
from gpusimbench.schemas.messages import enum_values
from gpusimbench.schemas.provenance import PROVENANCE, SCENE, SIMULATION, Provenance, Simulation

_PHASES = ("baseline", "init", "warmup", "timed", "capture")
_CLOCKED = ("build", "compile_timed", "warmup", "timed", "compile_capture")


def run_is_recorded_whole(subject: Subject) -> None:
    """The run ends complete, having passed all phases in order, with clocks, states, counts and overflow bits."""
    run = _run(subject)
    configuration, simulation = run.configuration, _simulation(run)
    kinds = {number: name.removeprefix("EVENT_KIND_") for name, number in enum_values("gsb.v1.EventKind").items()}
    marks = [(kinds[e.kind], e.phase) for e in run.decoded(topics.RUN_EVENT) if kinds[e.kind] != "NOTE"]
    expected = [(f"PHASE_{mark}", phase) for phase in _PHASES for mark in ("BEGIN", "END")]
    expect(marks == expected, f"phases are {', '.join(_PHASES)}, each begun and ended, not {marks}")
    interval = subject.adapter.timing_interval
    readings = {"warmup": -(-configuration.warmup // interval), "timed": -(-configuration.timed_steps // interval)}
    for phase in _CLOCKED:
        found = [len(timing.start_ns) for timing in run.decoded(topics.timing(phase))]
        expect(found == [readings.get(phase, 1)], f"clock readings of {phase}: {readings.get(phase, 1)}, not {found}")
    for layout in simulation.fields:
        blocks = [decode_state(data)[1] for data in run.messages[topics.state(layout.group, layout.field, 0)]]
        rows = [sum(len(array) for array in blocks), *blocks[0].shape[1:]] if blocks else []
        shape = [configuration.steps + 1, configuration.n_env, len(layout.items), layout.width]
        expect(rows == shape, f"recorded {layout.name} has shape {rows}, not [step, env, item, width] = {shape}")
    wanted = {"capture": configuration.steps, "timed": 2}
    for phase, steps in wanted.items():
        for counter in simulation.counters:
            counted = sum(len(m.max) for m in run.decoded(topics.count(phase, counter.name)))
            expect(counted == steps, f"{counter.name} is recorded for {counted} rows of phase {phase}, not {steps}")
        if simulation.overflow_bits:
            counted = sum(len(m.bits) for m in run.decoded(topics.overflow(phase)))
            expect(counted == steps, f"overflow bits are recorded for {counted} rows of phase {phase}, not {steps}")


def recording_says_what_it_is_of(subject: Subject) -> None:
    """Provenance holds what was asked, the machine and the software; simulation.json what the adapter says."""
    run = _run(subject)
    configuration, simulation = run.configuration, _simulation(run)
    provenance = Provenance.from_json(run.attachments[PROVENANCE])
    expect(provenance.configuration == configuration, f"{PROVENANCE} holds another configuration than was asked for")
    for part in ("host", "software"):
        expect(bool(getattr(provenance, part)), f"{PROVENANCE} says nothing of the {part}")
    digest = hashlib.sha256(run.attachments[SCENE]).hexdigest()
    expect(simulation.scene.get("sha256") == digest, f"{SCENE} is not the scene that {SIMULATION} names")
    described = subject.trajectory.description
    for name in ("version", "device", "switches", "counters", "overflow_bits"):
        found, said = getattr(simulation, name), getattr(described, name)
        expect(found == said, f"{SIMULATION} has {name} {found}; the adapter said {said} in the conformance scene")
    for name in described.attachments:
        expect(
            bool(run.attachments.get(name)), f"attachment {name}, as in the conformance scene, is not in the recording"
        )


def timed_steps_lead_where_captured_ones_do(subject: Subject) -> None:
    """After the timed steps of a recording the state has the hash that the capture has at that step."""
    run = _run(subject)
    hashes: dict[str, dict[int, np.ndarray]] = {}
    for phase in ("timed", "capture"):
        rows = hashes[phase] = {}
        for data in run.messages[topics.fingerprint(phase)]:
            header, found = decode_fingerprints(data)
            rows.update((header.first_step + k * header.stride, row) for k, row in enumerate(found))
    shared = sorted(set(hashes["timed"]) & set(hashes["capture"]))
    expect(bool(shared), "the recording's phases have no step in common")
    differ = [step for step in shared if not np.array_equal(hashes["timed"][step], hashes["capture"][step])]
    if differ:
        expect_repeatable(subject)
        fail(f"timed and captured states differ at steps {differ}, though two captures are the same")


def _run(subject: Subject) -> RecordedRun:
    if subject.entry is None:
        raise NotApplicable("the adapter is not registered under a name that gsb-record would find")
    run = subject.recording
    expect(run.status == "complete", f"a run of {run.configuration.scene} ends {run.status}: {run.reason}")
    return run


def _simulation(run: RecordedRun) -> Simulation:
    scene = make_scene(run.configuration.scene)
    simulation = Simulation.from_json(run.attachments[SIMULATION])
    expect(simulation.scene.get("name") == scene.name, f"{SIMULATION} names another scene: {simulation.scene}")
    return simulation
