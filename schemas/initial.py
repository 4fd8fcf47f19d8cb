"""How the environments of a run begin: in states that are drawn for each, or in states that are given.

A RunConfiguration has this as a short text. To find out whether results depend on conditions that should not matter,
gsb-probe records runs that begin in other states, have other parameters, or are intervened in (schemas.treatment).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

MOST_SPREAD = 3.0
"""Largest spread of drawn initial states [m/s or rad]."""

GIVEN = "initial.npz"
"""Attachment with the states that a run was given to begin with, as of schemas.arrays."""

AXES = ("x", "y", "xy")
"""Coordinates whose signs change in images (schemas.symmetry): x in the plane x = 0, y in the plane y = 0, and both by
a half turn about z."""

ORDERS = ("reverse",)
"""Orders in which identical bodies get each other's states (schemas.symmetry)."""

_NUMBER = r"[0-9.eE+-]+"
_INITIAL = re.compile(rf"random:(?P<spread>{_NUMBER})(?:,(?P<kind>[a-z]+):(?P<value>[a-z0-9]{{1,8}}))?")
_GIVEN = re.compile(r"(?:states|snapshot:(?P<step>\d{1,12})):(?P<sha256>[0-9a-f]{64})")


def _one_of(known: Sequence[str]) -> Callable[[str], str]:
    def read(text: str) -> str:
        if text not in known:
            raise ValueError(text)
        return text

    return read


@dataclass(frozen=True)
class InitialKind:
    """A kind of drawn initial states that differ from the usual ones: "random:SPREAD,NAME:VALUE".

    Beside this declaration, a kind is a field of Initial and what recorder.run.start makes of it; of a symmetry of the
    scene, what schemas.symmetry makes of it. gsb-probe records it, and a question in evaluator.probe.questions judges
    it.

    name    of the field of Initial
    value   what stands for VALUE in messages
    does    in words
    read    VALUE from its text; ValueError where it is none
    probed  VALUEs that gsb-probe takes, of so many environments, a run each; empty: there is nothing to ask
    """

    name: str
    value: str
    does: str
    read: Callable[[str], int | str]
    probed: Callable[[int], Sequence[int | str]]

    @property
    def form(self) -> str:
        """How initial states of this kind are written."""
        return f"random:SPREAD,{self.name}:{self.value}"


_DRAWN_STATES = (
    InitialKind(
        "shift", "K", "begins each environment as the one K slots further", int,
        probed=lambda n_env: (max(1, n_env // 3),) if n_env > 1 else (),
    ),
    InitialKind(
        "but", "E", "begins all environments but E in other states", int,
        probed=lambda n_env: (0,) if n_env > 1 else (),
    ),
    InitialKind(
        "mirror", "AXES", "begins all environments in mirror images (x, y), or turned by a half turn (xy)",
        _one_of(AXES), probed=lambda n_env: ("y", "xy"),
    ),
    InitialKind(
        "relabel", "ORDER", f"begins identical bodies with each other's states ({', '.join(ORDERS)})", _one_of(ORDERS),
        probed=lambda n_env: ORDERS,
    ),
)  # fmt: skip
INITIAL_KINDS = {kind.name: kind for kind in _DRAWN_STATES}
"""Kinds of initial states by name."""


@dataclass(frozen=True)
class Initial:
    """Initial states that are drawn for each environment (recorder.run.start): "random:SPREAD", or of one of
    INITIAL_KINDS.

    spread  around the scene's first state [m/s or rad]
    shift   environment e begins as environment e + shift does without it, modulo their number: ",shift:K"
    but     all environments but this one begin otherwise than without it: ",but:E"; None: all as without it
    mirror  all environments begin in the images of these states by a reflection or a half turn, as of AXES:
            ",mirror:AXES"
    relabel identical bodies exchange these states, in an order of ORDERS: ",relabel:ORDER"
    """

    spread: float
    shift: int = 0
    but: int | None = None
    mirror: str = ""
    relabel: str = ""

    @classmethod
    def parse(cls, text: str) -> Initial:
        """From the text; ValueError where it is none."""
        found = _INITIAL.fullmatch(text)
        if not found:
            raise ValueError(text)
        spread, name = float(found["spread"]), found["kind"]
        if not 0 < spread <= MOST_SPREAD or (name and name not in INITIAL_KINDS):
            raise ValueError(text)
        return cls(spread).of_kind(name, INITIAL_KINDS[name].read(found["value"])) if name else cls(spread)

    def of_kind(self, name: str, value: int | str) -> Initial:
        """These initial states as a kind of INITIAL_KINDS has them, with the value of the kind."""
        changed: dict[str, Any] = {name: value}
        return replace(self, **changed)

    @property
    def kind(self) -> str:
        """The name of its kind; empty where states are the usual ones."""
        return next((name for name in INITIAL_KINDS if getattr(self, name) != getattr(Initial, name)), "")

    def __str__(self) -> str:
        return f"random:{self.spread!r}" + (f",{self.kind}:{getattr(self, self.kind)}" if self.kind else "")


@dataclass(frozen=True)
class Given:
    """Initial states that were given: "states:SHA256" or "snapshot:STEP:SHA256". The recording has them attached.

    sha256  of the attachment GIVEN [hex]
    step    None: positions and velocities. Else an engine's whole state after that step of another run, which this run
            continues: its first state is that of this step, and has its number
    """

    sha256: str
    step: int | None = None

    @classmethod
    def parse(cls, text: str) -> Given:
        """From the text; ValueError where it is none."""
        found = _GIVEN.fullmatch(text)
        if not found:
            raise ValueError(text)
        return cls(found["sha256"], None if found["step"] is None else int(found["step"]))

    def __str__(self) -> str:
        return f"{'states' if self.step is None else f'snapshot:{self.step}'}:{self.sha256}"


def parse_initial(text: str) -> Initial | Given:
    """How environments begin; ValueError where the text is nothing that is known."""
    return Initial.parse(text) if text.startswith("random:") else Given.parse(text)


def drawn(text: str) -> Initial | None:
    """How initial states were drawn; None where they were not."""
    return Initial.parse(text) if text.startswith("random:") else None


def initial_words(text: str) -> str:
    """How environments begin, or what actions they are given, short enough for a table."""
    return re.sub(r"([0-9a-f]{12})[0-9a-f]{52}$", r"\1", text)
