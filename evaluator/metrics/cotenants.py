"""Whether another process held memory on the device that a run stepped on, from figures of memory alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

from gpusimbench.evaluator.metrics.memory import Checkpoints, GpuMemory

UNEXPLAINED_BYTES = 32 << 20
"""So many bytes at the baseline are a process: the driver's own share varies by less than 1 MB between readings, and a
CUDA context takes more."""

UNLIKE_BYTES = 256 << 20
"""So many bytes that NVML attributes to nobody, beyond those of a run of the same configuration, are a process: in the
shipped recordings runs of one configuration are less than 100 MB apart."""

BASELINE = "baseline"
TIMED = "timed"

_LATER = ("post-init", "post-warmup", "final")

CHECKPOINTS = (BASELINE, *_LATER)
"""Of the protocol, as recordings name them."""


class Presence(Enum):
    """Whether another process was on the device; UNKNOWN where the recording does not tell, which is not NONE."""

    NONE = "none"
    SOME = "some"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Sign:
    """A sign that another process was there.

    moment     a checkpoint, or "timed"
    processes  how many NVML listed; None where the sign is another
    bytes      that they held, at least; None where it is not known
    by         what says so
    """

    moment: str
    processes: int | None
    bytes: int | None
    by: str


@dataclass(frozen=True)
class CoTenants:
    """Other processes on the device during a run.

    signs      in the order of moments
    looked     NVML told at every moment, and listed none beside the run's own process
    """

    signs: tuple[Sign, ...] = ()
    looked: bool = False

    @property
    def presence(self) -> Presence:
        """Whether another process was there, as far as is known."""
        return Presence.SOME if self.signs else Presence.NONE if self.looked else Presence.UNKNOWN


@dataclass(frozen=True)
class Peers:
    """What other runs show of the device.

    idle_bytes    least baseline of any run on the same kind of device, with the same driver; None without any
    unattributed  least bytes that NVML attributed to nobody, by checkpoint, of runs of the same configuration
    """

    idle_bytes: int | None = None
    unattributed: Mapping[str, int] = field(default_factory=dict)


NO_PEERS = Peers()


def cotenants(memory: GpuMemory, peers: Peers = NO_PEERS) -> CoTenants:
    """Other processes on a run's device, where it can be said with certainty; one sign a moment, the strongest."""
    signs: dict[str, Sign] = {}
    for sign in (*_listed(memory), *_at_baseline(memory, peers), *_unattributed(memory, peers)):
        signs.setdefault(sign.moment, sign)
    order = (BASELINE, *_LATER[:2], TIMED, _LATER[2])
    reached = [moment for moment in CHECKPOINTS if at(memory.device, moment) is not None]
    looked = (
        memory.reserved is not None
        and BASELINE in reached
        and len(reached) > 1
        and all(moment in memory.listed for moment in reached)
        and (memory.device.peak is None or TIMED in memory.listed)
    )
    return CoTenants(tuple(sorted(signs.values(), key=lambda sign: order.index(sign.moment))), looked)


def at(checkpoints: Checkpoints, moment: str) -> int | None:
    """The bytes of a checkpoint, by its name in recordings."""
    found: int | None = getattr(checkpoints, moment.replace("-", "_"))
    return found


def unattributed(memory: GpuMemory) -> dict[str, int]:
    """Bytes in use that NVML does not attribute to the run's process, by checkpoint behind the baseline.

    At a checkpoint the engine waits, so that both figures are of one state of it.
    """
    found = {}
    for moment in _LATER:
        device = at(memory.device, moment)
        own = at(memory.process, moment) if memory.process else None
        if device is not None and own is not None:
            found[moment] = device - own
    return found


def _listed(memory: GpuMemory) -> Iterator[Sign]:
    for moment, found in memory.listed.items():
        if found.processes:
            yield Sign(moment, found.processes, found.bytes, "NVML listed them")


def _at_baseline(memory: GpuMemory, peers: Peers) -> Iterator[Sign]:
    base = memory.device.baseline
    if base is None:
        return
    floors: list[tuple[int, str]] = []
    if memory.reserved is not None:
        floors.append((memory.reserved, "more was in use than the driver keeps for itself"))
    if peers.idle_bytes is not None:
        floors.append((peers.idle_bytes, "another run's baseline on the same kind of GPU is lower"))
    # what is in use later beside the run's own process was there for others then, and so were fewer bytes than before
    floors += [(left, f"they were in use no more at {moment}") for moment, left in unattributed(memory).items()]
    floors += [
        (used, f"they were in use no more at {moment}")
        for moment in _LATER
        if (used := at(memory.device, moment)) is not None
    ]
    if floors:
        floor, by = min(floors)
        if base - floor > UNEXPLAINED_BYTES:
            yield Sign(BASELINE, None, base - floor, by)
            return
    if memory.device.shrank and memory.device.peak is not None:
        yield Sign(BASELINE, None, base - memory.device.peak, "they were in use no more in the timed phase")


def _unattributed(memory: GpuMemory, peers: Peers) -> Iterator[Sign]:
    for moment, beside in unattributed(memory).items():
        least = peers.unattributed.get(moment)
        if least is not None and beside - least > UNLIKE_BYTES:
            yield Sign(moment, None, beside - least, "a run of the same configuration has less beside its own process")


def peers_of(memories: Sequence[GpuMemory], *, idle_bytes: int | None) -> Peers:
    """What runs of one configuration show each other."""
    least: dict[str, int] = {}
    for memory in memories:
        for moment, beside in unattributed(memory).items():
            least[moment] = min(beside, least.get(moment, beside))
    return Peers(idle_bytes, least)
