"""What differs between runs: a number that each run draws, and keeps in its recording."""

from __future__ import annotations

import os
from functools import cache

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.calibration.options import BY_ENV, BY_RUN, DIGITS, CalibrationOptions


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
