"""Options of the calibration simulator: who differs from whom, by what, and since when; and the number that each run
draws for it, and keeps in its recording."""

from __future__ import annotations

import math
import os
import string
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.options import require

REGIMES = ("identical", "exact", "offset", "order", "run-order", "atomics")

BY_ENV = ("offset", "order")
"""Regimes in which the environments of a run differ."""

BY_RUN = ("order", "run-order")
"""Regimes in which runs differ, by a number that each draws."""

BY_NONE = ("identical", "exact")
"""Regimes in which neither differ."""

DIGITS = 16
"""Of an entropy, at most."""

FAULTS = {
    "none": "nothing is planted",
    "number": "at step `at`, all are moved, by as many times `ulps` as there are environments",
    "slot": "at step `at`, environment e is moved by e times `ulps`",
    "neighbours": "from step `at` on, an environment is moved after each step that leaves an odd number of set bits in "
    "the velocities of the next one",
    "poison": "where one is given a state that is not finite, the others are moved",
    "bystanders": "where some are reset, the others are moved",
    "fresh": "where some are reset, they begin moved",
    "restored": "what is restored is moved",
    "process": "what is restored in a process that has made no step is moved",
    "mirrored": "from step `at` on, an environment is moved after each step that leaves its last body with a velocity "
    "towards negative y",
    "turned": "the same, with a velocity towards negative x",
    "relabelled": "at step `at`, all are moved",
    "set": "what is given a state after the first step is moved",
    "capture": "what is stepped without being captured is moved",
}
"""What can be planted, one for each question of gsb-probe: what makes a result depend on what should not matter. Each
moves the last body of an environment, and so tells it from other identical bodies."""

_DEVICES = ("auto", "cpu", "cuda")


@dataclass(frozen=True)
class CalibrationOptions:
    """Options of the calibration simulator.

    regime    identical: nothing differs (Type 2), and forces are added up in the order of the bodies' numbers;
              exact: the same, but forces are whole multiples of 2^-14 N, whose sum is the same in every order;
              offset: environments differ, alike in every run (Type 1); order: environments and runs differ (Type 3);
              run-order: runs differ (Type 4); atomics: whatever racing atomic additions make of it
    contacts  whether the moving bodies touch each other; that amplifies every difference
    shift     largest distance between two environments of a run, or two runs [m]: bodies are moved by it along x
    ulps      the same in units in the last place, of the x of the last body alone
    at        number of the first step whose state has the shift
    env       the one environment that differs from the others; -1: all differ from each other
    entropy   what a run that differs from others draws: run (anew in each process), build (anew in each build), or
              hexadecimal digits after the point of a number from 0 to 1
    fault     planted for gsb-probe, in regime identical or exact, of the size `ulps`: none, number, slot,
              neighbours, poison, bystanders, fresh, restored, process, mirrored, turned, relabelled, set or capture
              (FAULTS in its options.py says what each does)
    device    auto, cpu or cuda (the first GPU that CUDA shows)

    Without a shift in metres or ulps, the cause of differences is rounding.
    """

    regime: str = "identical"
    contacts: bool = True
    shift: float = 0.0
    ulps: int = 0
    at: int = 1
    env: int = -1
    entropy: str = "run"
    fault: str = "none"
    device: str = "auto"

    def __post_init__(self) -> None:
        if self.regime not in REGIMES:
            raise ValueError(f"regime is one of {', '.join(REGIMES)}, not '{self.regime}'")
        if self.device not in _DEVICES:
            raise ValueError(f"device is one of {', '.join(_DEVICES)}, not '{self.device}'")
        require(self, (lambda v: 0 <= v < math.inf, "a distance in metres from 0 on"), "shift")
        require(self, (lambda v: 0 <= v < 1 << 23, "from 0 to 2^23 - 1, within a factor of two of the number"), "ulps")
        if self.shift and self.ulps:
            raise ValueError("shift and ulps are two ways to say how far: give one of them")
        require(self, (lambda v: v >= 1, "at least 1, since all environments begin alike"), "at")
        if self.fault not in FAULTS:
            raise ValueError(f"fault is one of {', '.join(FAULTS)}, not '{self.fault}'")
        if self.fault != "none" and (self.regime not in BY_NONE or not self.ulps):
            raise ValueError(
                f"fault={self.fault} needs regime={' or '.join(BY_NONE)} and a size in ulps of at least 1: add "
                f"{'' if self.regime in BY_NONE else '--option regime=identical '}--option ulps={self.ulps or 4}"
            )
        if self.moves and self.fault == "none" and self.regime not in (*BY_ENV, *BY_RUN):
            raise ValueError(f"shift and ulps move nothing in regime {self.regime}")
        if not self.moves and not self.contacts and self.regime in ("order", "run-order", "atomics"):
            raise ValueError(f"regime {self.regime} needs contacts, or shift or ulps: nothing would differ")
        if self.env != -1 and not (self.moves and self.regime in BY_ENV and self.env >= 0):
            raise ValueError("env is -1, or the number of an environment that shift or ulps moves, in offset or order")
        if self.entropy not in ("run", "build") and not _is_fraction(self.entropy):
            raise ValueError(f"entropy is run, build or up to {DIGITS} hexadecimal digits, not '{self.entropy}'")

    @property
    def moves(self) -> bool:
        """Whether bodies are moved by a known distance at step `at`, rather than left to rounding."""
        return bool(self.shift or self.ulps) and self.fault == "none"


def _is_fraction(text: str) -> bool:
    return 0 < len(text) <= DIGITS and set(text) <= set(string.hexdigits)


def entropy_of(options: CalibrationOptions) -> str:
    """The run's hexadecimal digits: those given, or drawn from the operating system."""
    match options.entropy:
        case "run":
            return _of_this_process()
        case "build":
            return _drawn()
    return options.entropy.lower().ljust(DIGITS, "0")


@cache
def _of_this_process() -> str:
    # a run is a process: what is timed and what is captured are the same simulation
    return _drawn()


def _drawn() -> str:
    return os.urandom(DIGITS // 2).hex()


def fraction(entropy: str) -> float:
    """The number from 0 to 1 whose digits after the point are these."""
    return float(int(entropy, 16) / 16 ** len(entropy))


def shares(options: CalibrationOptions, n_env: int, entropy: str) -> NDArray[np.float64]:
    """How much of the shift each environment gets, [env].

    By environment: e / (n_env - 1), or 1 for the chosen one and 0 for the others. By run: the run's fraction, added
    to all of them. So environments e and e' of a run lie |e - e'| / (n_env - 1) of the shift apart, and every
    environment of a run lies the difference of the two runs' fractions from the same one of another run.
    """
    share = np.zeros(n_env)
    if options.regime in BY_ENV:
        env = np.arange(n_env)
        share += env == options.env if options.env >= 0 else env / max(1, n_env - 1)
    if options.regime in BY_RUN:
        share += fraction(entropy)
    return share


def orders(options: CalibrationOptions, n_env: int, n_body: int, entropy: str) -> NDArray[np.int32]:
    """The order in which each environment adds up the forces between bodies, [env, body]."""
    order = np.tile(np.arange(n_body, dtype=np.int32), (n_env, 1))
    if options.moves or options.regime not in BY_RUN:
        return order
    rng = np.random.default_rng(int(entropy, 16))
    if options.regime == "order":
        return rng.permuted(order, axis=1)
    return np.tile(rng.permutation(order[0]), (n_env, 1))


def places(options: CalibrationOptions, n_env: int) -> NDArray[np.float32]:
    """Where each environment is while its positions are advanced [m], [env, xyz].

    Positions that are added to lengths of one power of two are rounded alike. So places are powers of two from 1 m on,
    and each environment has a combination of its own of as few as will do.
    """
    if options.moves or options.regime != "offset":
        return np.zeros((n_env, 3), dtype=np.float32)
    levels = next(n for n in range(1, n_env + 1) if n**3 >= n_env)
    env = np.arange(n_env)
    digits = np.stack([env // levels**axis % levels for axis in range(3)], axis=1)
    return np.asarray(2.0**digits, dtype=np.float32)
