"""Parameters that differ from environment to environment: which environment had which, as a recording carries it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas import arrays
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.treatment import VARIED


@dataclass(frozen=True)
class Factors:
    """Of one quantity, such as "mass".

    items   names of the bodies and links, or of the robot
    values  by which the scene's parameters are multiplied, shape [env, item]
    """

    items: tuple[str, ...]
    values: NDArray[np.float64]


def factors_of(configuration: RunConfiguration, attached: bytes | None) -> dict[str, Factors]:
    """The factors by quantity; empty where all environments have the scene's parameters.

    attached  of the name VARIED

    DamagedRecording where they are missing, or are not what the configuration asks for.
    """
    if not configuration.vary:
        return {}
    if attached is None:
        raise DamagedRecording(f"environments have other parameters ({configuration.vary}), and {VARIED} is not there")
    given, found = arrays.decode(VARIED, attached), {}
    for quantity, spread in configuration.varied.items():
        values, items = given.get(quantity), given.get(f"{quantity}/items")
        if values is None or items is None or values.dtype.kind != "f" or items.dtype.kind != "U" or items.ndim != 1:
            raise DamagedRecording(f"{VARIED} has no factors of {quantity}")
        if values.shape != (configuration.n_env, items.size):
            raise DamagedRecording(
                f"{VARIED} has factors of {quantity} of the shape {values.shape}, not of {configuration.n_env} "
                f"environments and {items.size} items"
            )
        if not (np.abs(values - 1.0) <= spread).all():
            raise DamagedRecording(f"{VARIED} has factors of {quantity} that are not within 1 +- {spread:g}")
        found[quantity] = Factors(tuple(map(str, items)), values)
    return found
