"""Which recordings were reproduced: by replays among the recordings, whose states have the same bits.

A replay names what it replays, by run and content hash. That it does is its own word; that its states are those of the
original is computed, from state hashes that were held against the states.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from gpusimbench.evaluator.json_values import brief
from gpusimbench.evaluator.missing import every
from gpusimbench.evaluator.runs.run import Run

_MACHINE = ("cpu", "usable_threads", "memory_bytes")


@dataclass(frozen=True)
class Replay:
    """One replay of one original.

    content_hash   of the replay
    agrees         every captured state has the same bits; None where the two cannot be compared
    other_machine  it was made on another kind of machine than the original: other processor, threads, memory or GPUs;
                   None where one of the two recordings does not tell all of these
    machine        the kind, in words
    changed        settings that were other than recorded
    """

    content_hash: str
    agrees: bool | None
    other_machine: bool | None
    machine: str
    changed: tuple[str, ...] = ()


@dataclass(frozen=True)
class Reproduction:
    """Replays of the recordings of one group.

    originals   complete runs of the group that captured states and are no replays
    reproduced  how many of them have a replay that agrees
    replays     by the content hash of the original, of those that have any
    """

    originals: int
    reproduced: int
    replays: dict[str, tuple[Replay, ...]]

    @property
    def agreeing(self) -> tuple[Replay, ...]:
        """Replays whose states are those of their original."""
        return tuple(r for found in self.replays.values() for r in found if r.agrees)

    @property
    def machines(self) -> int:
        """How many kinds of machines the agreeing replays ran on."""
        return len({replay.machine for replay in self.agreeing})

    @property
    def elsewhere(self) -> int:
        """How many of these kinds are not the original's."""
        return len({replay.machine for replay in self.agreeing if replay.other_machine})

    @property
    def nowhere_else(self) -> str:
        """What is said where `elsewhere` is 0."""
        known = every(None if replay.other_machine is None else True for replay in self.agreeing)
        return "none other than its own" if known.yes else "which of them are others is not told"

    @property
    def count(self) -> int:
        """How many replays there are of all originals."""
        return sum(map(len, self.replays.values()))


def replays_of(files: Sequence[Run], whole: Collection[str]) -> dict[str, tuple[Replay, ...]]:
    """Replays by the content hash of what they replay; only of recordings that are among the files, each once.

    whole  content hashes of recordings that keep every rule; others reproduce nothing
    """
    known = {(f.provenance.run_id, f.content_hash): f for f in files if f.content_hash}
    found: dict[str, dict[str, Replay]] = {}
    for file in known.values():
        of = file.provenance.replay_of
        original = known.get((of.run_id, of.content_hash)) if of else None
        if of is None or original is None or original is file or file.content_hash not in whole:
            continue
        ours = machine_of(file)
        found.setdefault(of.content_hash, {})[file.content_hash] = Replay(
            file.content_hash, _agree(original, file), _other(original, file), ours,
            tuple(sorted(of.changed)),
        )  # fmt: skip
    return {original: tuple(replays.values()) for original, replays in found.items()}


def reproduction(group: Sequence[Run], replays: dict[str, tuple[Replay, ...]]) -> Reproduction:
    """What replays say of the complete runs of a group."""
    captured = [
        r.content_hash
        for r in group
        if r.usable and "capture" in r.configuration.phases and r.provenance.replay_of is None
    ]
    return Reproduction(
        originals=len(captured),
        reproduced=sum(any(replay.agrees for replay in replays.get(one, ())) for one in captured),
        replays={one: replays[one] for one in captured if one in replays},
    )


def machine_of(summary: Run) -> str:
    """The kind of machine that a recording says it is from."""
    host = summary.provenance.host
    cpu = ", ".join(str(brief(host.get(key, "?"))) for key in _MACHINE)
    return "; ".join([cpu, *(str(brief(gpu.get("name", "a GPU"))) for gpu in summary.provenance.gpus)])


def _other(one: Run, other: Run) -> bool | None:
    for summary in (one, other):
        told = [summary.provenance.host.get(key) for key in _MACHINE]
        told += [gpu.get("name") for gpu in summary.provenance.gpus]
        if not all(told):
            return None
    return machine_of(one) != machine_of(other)


def _agree(original: Run, replay: Run) -> bool | None:
    if not original.histories or not replay.histories:
        return None
    if _kind(original) != _kind(replay):
        return None
    rows = len(original.histories.steps)
    if len(replay.histories.steps) < rows:
        return None
    return original.histories.until(rows) == replay.histories.until(rows)


def _kind(recording: Run) -> tuple[object, ...]:
    # a replay may be of other options and on another device, and not of another simulator, scene or step
    c = recording.configuration
    return recording.fields, c.simulator, c.scene, c.n_env, c.dt
