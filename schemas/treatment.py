"""How a run differs from a plain one: which parameters environments have, which actions they are given, what is done to
them on the way, what is kept of them. How they begin is in schemas.initial.

Each is a short text in a RunConfiguration.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

MOST_METRES = 1e9
"""Of the bounds of environments."""

VARIED_SPREAD = 0.9
"""Of parameters that vary, at most: every factor is above zero."""

VARIED = "varied.npz"
"""Attachment with the factors of parameters that vary, as of schemas.arrays: QUANTITY [env, item] and QUANTITY/items,
the names of bodies, links or the robot."""

TEACHER = "teacher/"
"""Prefix of the arrays of schemas.initial.GIVEN that environments are set to later, by the intervention "teacher@K".

teacher/first        toss t has the rows first[t] to first[t + 1] - 1 of the arrays below, shape [toss + 1]
teacher/GROUP/FIELD  states of the group's items, shape [row, item, component]; row m of a toss, from 0, is set after
                     step (m + 1) K. Environment e repeats toss e modulo the number of tosses
"""

CONTROLS = "controls.npz"
"""Attachment with the controls that a model's actuators were given from a file, as of schemas.arrays: controls [step,
actuator], or [step, env, actuator], and, if the file had them, actuators, their names."""

SNAPSHOT = re.compile(r"snapshot-(\d{1,12})\.npz")
"""Attachment with an engine's whole state after a step."""

_NUMBER = r"[0-9.eE+-]+"
_VARIED = re.compile(rf"(?P<name>[a-z]+):(?P<value>{_NUMBER})")
_CONTROLS = re.compile(r"file(?P<each>-by-env)?:(?P<sha256>[0-9a-f]{64})")
_KEEP = re.compile(rf"failing(?:,within:(?P<within>{_NUMBER}))?")
_INTERVENTION = re.compile(r"(?P<kind>[a-z]+)@(?P<step>\d{1,9})(?:\+(?P<more>\d{1,9}))?")


@dataclass(frozen=True)
class FromFile:
    """Controls from a file: "file:SHA256", or "file-by-env:SHA256" where each environment has its own.

    sha256    of the attachment CONTROLS [hex]
    each      each environment has its own
    """

    sha256: str
    each: bool = False

    @classmethod
    def parse(cls, text: str) -> FromFile | None:
        """From the actions of a RunConfiguration; None where they are not from a file."""
        found = _CONTROLS.fullmatch(text)
        return cls(found["sha256"], bool(found["each"])) if found else None

    def __str__(self) -> str:
        return f"file{'-by-env' if self.each else ''}:{self.sha256}"


def alike(actions: str) -> bool:
    """Whether the actions of a RunConfiguration are the same for all environments."""
    found = FromFile.parse(actions)
    return actions == "keyframe" or (found is not None and not found.each)


def snapshot_name(step: int) -> str:
    """The name of the attachment with the snapshot after that step."""
    return f"snapshot-{step}.npz"


QUANTITIES = {
    "mass": "of each moving body and link, with its moments of inertia",
    "friction": "both coefficients of the surface of each moving body, and of a robot",
    "size": "of each free body, about its centre; the mass stays, the moments of inertia are those of the larger solid",
}
"""Parameters that may vary from environment to environment, and what a factor of each scales."""


@dataclass(frozen=True)
class Vary:
    """Parameters that are drawn for each environment (recorder.run.vary): "mass:SPREAD,friction:SPREAD,size:SPREAD",
    at least one of them.

    spreads  by quantity, in the order of QUANTITIES: each factor is within 1 +- spread
    shift    environment e has the parameters that environment e + shift has without it, modulo their number: ",shift:K"
    but      all environments but this one have other parameters than without it: ",but:E"; None: all as without it
    """

    spreads: tuple[tuple[str, float], ...]
    shift: int = 0
    but: int | None = None

    @classmethod
    def parse(cls, text: str) -> Vary:
        """From the text; ValueError where it is none."""
        given: dict[str, str] = {}
        for part in text.split(","):
            found = _VARIED.fullmatch(part)
            if not found or found["name"] in given:
                raise ValueError(text)
            given[found["name"]] = found["value"]
        places = {name: given.pop(name) for name in ("shift", "but") if name in given}
        spreads = {name: float(given.pop(name)) for name in QUANTITIES if name in given}
        if given or not spreads or len(places) > 1 or not all(word.isdecimal() for word in places.values()):
            raise ValueError(text)
        if not all(0 < spread <= VARIED_SPREAD for spread in spreads.values()):
            raise ValueError(text)
        but = int(places["but"]) if "but" in places else None
        return cls(tuple(spreads.items()), int(places.get("shift", 0)), but)

    @property
    def usual(self) -> Vary:
        """The same, every environment in its own place and with its own parameters."""
        return Vary(self.spreads)

    def __str__(self) -> str:
        tail = f",shift:{self.shift}" if self.shift else "" if self.but is None else f",but:{self.but}"
        return ",".join(f"{name}:{spread!r}" for name, spread in self.spreads) + tail


@dataclass(frozen=True)
class InterventionKind:
    """A kind of intervention: what it does to states after a step of the capture, and what readers conclude from that.

    Beside this declaration, a kind is a function in recorder.run.intervention. gsb-probe records it, if `probed`, and a
    question in evaluator.probe.questions judges it.

    name      in the text of an intervention
    does      in words
    treats    whether something is done to environment e
    changes   the states of these environments do not go on as they would have
    poisons   the states of these environments need not be finite
    restarts  these environments begin anew, and so do their actions
    more      it takes further steps: "NAME@STEP+MORE"
    repeats   it is done after each whole multiple of the step
    probed    the results of a sound engine do not depend on it, or only in the environments that it changes
    """

    name: str
    does: str
    treats: Callable[[int], bool] = lambda env: True
    changes: bool = False
    poisons: bool = False
    restarts: bool = False
    more: bool = False
    repeats: bool = False
    probed: bool = True

    @property
    def form(self) -> str:
        """How an intervention of this kind is written."""
        return f"{self.name}@{'STEPS' if self.repeats else 'STEP'}{'+MORE' if self.more else ''}"


_KINDS = (
    InterventionKind(
        "poison", "makes the state of environment 1 not finite, as a diverged solver leaves it",
        treats=lambda env: env == 1, changes=True, poisons=True,
    ),
    InterventionKind(
        "reset", "resets every second environment, from 0 on",
        treats=lambda env: env % 2 == 0, changes=True, restarts=True,
    ),
    InterventionKind(
        "excursion", "saves the state, makes MORE steps that are not recorded, and restores the state", more=True
    ),
    InterventionKind("set", "writes back the current positions and velocities"),
    InterventionKind(
        "teacher", "sets every environment to the measured state of its toss after each STEPS steps, while the toss "
        "goes on (teacher forcing)", changes=True, repeats=True, probed=False,
    ),
)  # fmt: skip
KINDS = {kind.name: kind for kind in _KINDS}
"""Kinds of interventions by name."""


@dataclass(frozen=True)
class Intervention:
    """What is done to the state of some environments after a step of the capture, as of InterventionKind.form.

    name  of one of KINDS
    step  after which it is done; of a kind that repeats: after each whole multiple of it
    more  further steps, of a kind that takes them
    """

    name: str
    step: int
    more: int = 0

    @classmethod
    def parse(cls, text: str) -> Intervention:
        """From the text; ValueError where it is none."""
        found = _INTERVENTION.fullmatch(text)
        if not found or found["kind"] not in KINDS:
            raise ValueError(text)
        made = cls(found["kind"], int(found["step"]), int(found["more"] or 0))
        if str(made) != text or made.kind.more != bool(made.more) or (made.kind.repeats and not made.step):
            raise ValueError(text)
        return made

    @classmethod
    def of(cls, text: str) -> Intervention | None:
        """From the intervention of a RunConfiguration; None where it is empty."""
        return cls.parse(text) if text else None

    def __str__(self) -> str:
        return f"{self.name}@{self.step}" + (f"+{self.more}" if self.more else "")

    @property
    def kind(self) -> InterventionKind:
        """The kind of the intervention: what it does, and what follows."""
        return KINDS[self.name]

    def stops(self, last: int) -> range:
        """The steps after which it is done, of a capture up to step `last`."""
        return range(self.step, last, self.step) if self.kind.repeats else range(self.step, self.step + 1)

    def treated(self, n_env: int) -> list[int]:
        """Environments that something is done to, of so many."""
        return [env for env in range(n_env) if self.kind.treats(env)]

    def poisoned(self, n_env: int) -> frozenset[int]:
        """Environments whose states need not be finite."""
        return frozenset(self.treated(n_env) if self.kind.poisons else ())


@dataclass(frozen=True)
class Keep:
    """Which states are written: "failing", "failing,within:METRES"; those of environments that fail.

    within  a body that is further than this from the origin of its environment, along any axis, is out of bounds [m];
            None: there are no bounds
    """

    within: float | None = None

    @classmethod
    def parse(cls, text: str) -> Keep:
        """From the text; ValueError where it is none."""
        found = _KEEP.fullmatch(text)
        if not found:
            raise ValueError(text)
        within = None if found["within"] is None else float(found["within"])
        if within is not None and not 0 < within <= MOST_METRES:
            raise ValueError(text)
        return cls(within)

    def __str__(self) -> str:
        return "failing" if self.within is None else f"failing,within:{self.within!r}"
