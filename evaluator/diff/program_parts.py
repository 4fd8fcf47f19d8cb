"""What two runs of one program have in common and where each part of it differs first."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from gpusimbench.schemas.fields import ENV

_ACTION = f"{ENV}/action"


def is_action(field: str) -> bool:
    """Whether a state field, "group/field", is what an environment was given; the others are what it returned."""
    return field == _ACTION or field.startswith(f"{_ACTION}_")


class Kind(Enum):
    """What a part is, in the order in which the parts of one step come about."""

    ACTION = "action"
    SIMULATOR = "simulator"
    PROGRAM = "program"


@dataclass(frozen=True)
class Moment:
    """A place in the order of a program's events.

    states  how many states precede an update; of the state of step k itself, and of its action, k + 1
    order   number of an update among all updates; 0 for states and actions
    """

    states: int
    order: int


@dataclass(frozen=True)
class ComparedPart:
    """A state field, or the arrays of one name that a program hashed.

    kind      see Kind
    name      "group/field", or the name of the arrays
    begin     when it is known first
    count_a   how many steps or updates a has of it
    count_b   b likewise
    first     the first difference; None where there is none
    update    number of the update that differs; None of states, and where nothing differs
    arrays    names of the arrays that differ in it
    reason    what differs, where it is not the arrays: how many updates there are, and when; empty otherwise
    """

    kind: Kind
    name: str
    begin: Moment
    count_a: int
    count_b: int
    first: Moment | None = None
    update: int | None = None
    arrays: tuple[str, ...] = ()
    reason: str = ""


@dataclass(frozen=True)
class ProgramDifference:
    """How what a program gave and got differs: which part is the first.

    parts        states, actions and arrays that both recordings have
    first        of the parts the one that differs first in the order of the program; None where all are the same
    same_before  names of the parts that are known before, all of which are the same until then
    last_same    the last event before, in words; empty where there is none
    only_a       names of arrays that a alone has
    only_b       b likewise
    """

    parts: tuple[ComparedPart, ...]
    first: ComparedPart | None
    same_before: tuple[str, ...]
    last_same: str
    only_a: tuple[str, ...]
    only_b: tuple[str, ...]
