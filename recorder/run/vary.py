"""Parameters that are drawn, so that environments are not all of one scene: what --vary takes, and who can do it."""

from __future__ import annotations

import numpy as np

from gpusimbench.recorder.abilities import VARIED, Ability, listed, titles
from gpusimbench.recorder.run import draws
from gpusimbench.recorder.run.draws import GRID
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.variation import Factors, Variation, varied_items
from gpusimbench.recorder.simulators.base import Simulator
from gpusimbench.schemas import arrays
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.treatment import QUANTITIES, VARIED_SPREAD, Vary

_STREAM = 0x56415259  # tells these words from those of actions and of initial states, which the same seed draws


def variation(text: str, scene: Scene, *, n_env: int, seed: int) -> Variation | None:
    """The parameters of each environment, as RunConfiguration.vary says; None where they are the scene's.

    The factor of a quantity is 1 plus a number that is drawn within +- its spread (``recorder.run.draws``), with the
    stream 0x56415259 and the quantity's number in schemas.treatment.QUANTITIES as the field: independently for each
    environment and each body, link or robot, in the order of the scene.
    """
    if not text:
        return None
    how, fields = Vary.parse(text), list(QUANTITIES)
    found = {}
    for quantity, spread in how.spreads:
        items = varied_items(scene, quantity)
        shape, field = (n_env, len(items)), fields.index(quantity)
        found[quantity] = Factors(
            items, 1.0 + draws.draw(how, spread, seed=seed, stream=_STREAM, field=field, shape=shape)
        )
    return Variation(found)


def attachment(drawn: Variation) -> bytes:
    """The factors as a recording carries them."""
    return arrays.encode(
        {
            name: array
            for quantity, factors in drawn.factors.items()
            for name, array in ((quantity, factors.values), (f"{quantity}/items", np.array(factors.items)))
        }
    )


def refusal(name: str, adapter: type[Simulator], options: object, scene: Scene, text: str) -> str:
    """Why a simulator cannot give the environments of a scene such parameters; empty where it can."""
    if not text:
        return ""
    asked = [quantity for quantity, _ in Vary.parse(text).spreads]
    needs, withheld = {VARIED[quantity] for quantity in asked}, adapter.withheld(options)
    if missing := titles(needs - adapter.offered(options)):
        return f"simulator '{name}' cannot do --vary {text}: it has no {listed(missing)}"
    if lacking := needs & withheld.keys():
        return f"simulator '{name}' cannot do --vary {text} with these options: {_instead(lacking, withheld)}"
    for quantity in asked:
        if not varied_items(scene, quantity):
            return f"--vary {text}: scene '{scene.name}' describes no body or robot whose {quantity} could vary"
    return ""


def _instead(lacking: set[Ability], withheld: dict[Ability, str]) -> str:
    ways = dict.fromkeys(how for ability, how in withheld.items() if ability in lacking)
    return f"it has no {listed(titles(lacking))}: use {'; '.join(ways)}"


def parse(text: str, n_env: int) -> str:
    """What --vary says, as the recording keeps it. UsageError where nothing can be drawn so."""
    try:
        how = Vary.parse(text)
        if min(spread for _, spread in how.spreads) < GRID or (how.but or 0) >= n_env:
            raise ValueError(text)
    except ValueError:
        raise UsageError(
            f"--vary takes {', '.join(f'{name}:SPREAD' for name in QUANTITIES)}, separated by commas, each at most "
            f"once, with spreads from {GRID!r} to {VARIED_SPREAD:g}, and may end with ,shift:K or with ,but:E, an "
            f"environment, not '{text}'"
        ) from None
    return str(how)
