"""What shows that the steps did their work: counts, overflow bits, gates."""

from __future__ import annotations

import re

import numpy as np

from gpusimbench.recorder.conformance.checks.agreement import expect_repeatable, stepped_differently
from gpusimbench.recorder.conformance.scene import LANDING
from gpusimbench.recorder.conformance.subject import Subject
from gpusimbench.recorder.conformance.verdict import NotApplicable, expect, fail
from gpusimbench.recorder.simulators.base import Description
from gpusimbench.recorder.simulators.evidence import CONTACTS, Evidence

_NAME = re.compile(r"[a-z0-9_]+")  # it becomes part of a topic
_BITS = 32
_STACK_CONTACTS = 6  # three points hold up a cube, and there are two
_SETTLED = 10


def evidence_has_a_row_for_every_step(subject: Subject) -> None:
    """After states a row for each of its steps, after step one row, of all counters that the description declares."""
    trajectory, stepped = subject.trajectory, subject.stepped
    description = trajectory.description
    _expect_declarations(description)
    said = [
        *zip(trajectory.blocks, trajectory.evidence, strict=True),
        *((1, evidence) for evidence in stepped.evidence),
    ]
    if not description.counters and not description.overflow_bits:
        for _, evidence in said:
            unnamed = evidence is not None and (evidence.counts or evidence.overflow is not None)
            expect(not unnamed, "evidence() counts something, and the description declares no counters and no bits")
        raise NotApplicable("the adapter declares no counters and no overflow bits")
    for place, (rows, evidence) in enumerate(said):
        after = f"states({rows})" if place < len(trajectory.blocks) else "step"
        if evidence is None:
            fail(f"evidence() gives None after {after}, and the description declares counters or overflow bits")
        _expect_rows(description, evidence, after, (rows, trajectory.n_env))


def _expect_declarations(description: Description) -> None:
    names = [counter.name for counter in description.counters]
    expect(len(set(names)) == len(names), f"counters are declared twice: {names}")
    for counter in description.counters:
        expect(bool(_NAME.fullmatch(counter.name)), f"a counter's name has a-z, 0-9 and _ alone, not '{counter.name}'")
        expect(bool(counter.meaning), f"counter {counter.name} does not say what it means")
    bits = [bit.bit for bit in description.overflow_bits]
    expect(len(set(bits)) == len(bits), f"overflow bits are declared twice: {bits}")
    for bit in description.overflow_bits:
        expect(0 <= bit.bit < _BITS, f"overflow bit {bit.name} is number {bit.bit}; a mask has {_BITS}")
        expect(bool(bit.name), f"overflow bit {bit.bit} has no name")


def _expect_rows(description: Description, evidence: Evidence, after: str, shape: tuple[int, int]) -> None:
    declared = {counter.name for counter in description.counters}
    unknown, missing = set(evidence.counts) - declared, declared - set(evidence.counts)
    expect(not unknown, f"evidence() after {after} counts {sorted(unknown)}; declared are {sorted(declared)}")
    expect(not missing, f"evidence() after {after} lacks {sorted(missing)}, which the description declares")
    for name, counts in evidence.counts.items():
        expect(counts.shape == shape, f"{name} after {after} has shape {counts.shape}, not [row, env] = {shape}")
        expect(counts.dtype.kind in "iu", f"{name} after {after} is {counts.dtype}; counts are whole numbers")
        expect(bool((counts >= 0).all()), f"{name} after {after} is negative: {counts.min()}")
    if not description.overflow_bits:
        return
    if evidence.overflow is None:
        fail(f"evidence() after {after} has no overflow bits, and the description declares some")
    overflow = evidence.overflow
    expect(overflow.shape == shape, f"overflow after {after} has shape {overflow.shape}, not [row, env] = {shape}")
    expect(overflow.dtype.kind == "u", f"overflow after {after} is {overflow.dtype}; masks are unsigned")


def overflow_stays_silent(subject: Subject) -> None:
    """No bit that makes a run invalid is set in a scene as small as this, nor any that is not declared."""
    trajectory = subject.trajectory
    bits = trajectory.description.overflow_bits
    if not bits:
        raise NotApplicable("the adapter declares no overflow bits")
    fatal = {bit.bit: bit.name for bit in bits if bit.fatal}
    declared = sum(1 << bit.bit for bit in bits)
    for evidence in (*trajectory.evidence, *subject.stepped.evidence):
        masks = evidence.overflow if evidence is not None else None
        if masks is None:
            continue
        found = int(np.bitwise_or.reduce(masks, axis=None))
        dropped = [name for bit, name in fatal.items() if found >> bit & 1]
        sizes = ", ".join(f"{b.name} {b.asked} per {b.per}" for b in trajectory.description.buffers)
        expect(not dropped, f"overflow: {', '.join(dropped)} (buffers: {sizes or 'none declared'})")
        expect(not found & ~declared, f"overflow bits that are not declared: {found & ~declared:#x}")


def gates_stay_silent(subject: Subject) -> None:
    """No validity gate fires, neither while states are captured nor while steps are timed."""
    for how, gates in (("states", subject.trajectory.gates), ("step", subject.stepped.gates)):
        expect(not gates, f"gates after {how} in a scene where nothing is wrong: {'; '.join(gates)}")


def contacts_hold_up_the_stack(subject: Subject) -> None:
    """From the tenth step on, at least three contact points under each of the two cubes at rest."""
    contacts = subject.trajectory.count(CONTACTS.name)[_SETTLED:]
    expect(
        bool((contacts >= _STACK_CONTACTS).all()),
        f"{contacts.min()} contacts in one env; two cubes at rest have at least {_STACK_CONTACTS}",
    )


def contacts_change_when_a_pebble_lands(subject: Subject) -> None:
    """The first steps do not all have the same number of contacts: a pebble lands in them."""
    contacts = subject.trajectory.count(CONTACTS.name)[: 2 * LANDING]
    expect(
        bool((contacts.min(axis=0) < contacts.max(axis=0)).all()),
        f"{contacts.max()} contacts at each of the first {2 * LANDING} steps, though a pebble lands at step {LANDING}",
    )


def counts_agree_step_by_step(subject: Subject) -> None:
    """Counts of each of the first steps are the same from step, made one by one, as from states."""
    trajectory, stepped = subject.trajectory, subject.stepped
    counters = trajectory.description.counters
    if not counters:
        raise NotApplicable("the adapter declares no counters")
    if stepped_differently(subject):
        expect_repeatable(subject)
        raise NotApplicable("step and states lead to different states: see step_and_states_agree")
    for counter in counters:
        captured = trajectory.count(counter.name)
        for step, evidence in enumerate(stepped.evidence[:-1]):
            found = evidence.counts[counter.name][-1] if evidence is not None else None
            expect(
                found is not None and np.array_equal(found, captured[step]),
                f"{counter.name} of step {step + 1}: {captured[step]} by states, {found} by step",
            )


def buffers_are_larger_than_what_they_held(subject: Subject) -> None:
    """What was counted stays below the capacity of the buffer that holds it."""
    trajectory = subject.trajectory
    shown = [buffer for buffer in trajectory.description.buffers if buffer.counter]
    if not shown:
        raise NotApplicable("the adapter has no buffer that a counter shows the use of")
    for buffer in shown:
        counts = trajectory.count(buffer.counter)
        peak = int(counts.max() if buffer.per == "env" else counts.sum(axis=1).max())
        expect(
            peak < buffer.asked,
            f"buffer {buffer.name} has {buffer.asked} entries per {buffer.per}; {peak} {buffer.counter} were counted",
        )
