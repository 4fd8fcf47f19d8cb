"""Every registered simulator that is installed conforms, each in a process of its own.

Where an engine is known not to, the table says so and why; a check that passes against the table fails the test, so
that the table stays true.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import pytest

from gpusimbench.recorder.abilities import Ability
from gpusimbench.recorder.conformance import CHECKS
from gpusimbench.recorder.environments.store import find
from gpusimbench.recorder.options import parse_options
from gpusimbench.recorder.simulators.registry import BUILT_IN, find_simulator
from tests.conftest import UNOPTIMISED

_NO_BITS = {"overflow_stays_silent": "the adapter declares no overflow bits"}
_NO_COUNTS = {
    **_NO_BITS,
    "evidence_has_a_row_for_every_step": "declares no counters",
    "contacts_hold_up_the_stack": "does not count contacts",
    "contacts_change_when_a_pebble_lands": "does not count contacts",
    "counts_agree_step_by_step": "declares no counters",
}
_NO_BUFFERS = {"buffers_are_larger_than_what_they_held": "no buffer that a counter shows"}
_NO_ORIENTATION = dict.fromkeys(
    ("quaternions_are_normalised", "turns_counter_clockwise", "stack_at_rest_stays"), "does not record orientation"
)

_PARTIAL_STATE = {"set_state_starts_afresh": "set_state is partial"}

_NO_PARAMETERS = {"varied_envs_are_those_of_their_scenes": "has no masses per environment"}

_SINKS = "sinks into the board at a step of 0.01 s"

_VARYING = "not deterministic"
"""How a skip begins that depends on the device; allowed everywhere."""


@dataclass(frozen=True)
class Variant:
    """A simulator with options.

    fails    checks that are known to fail, and why
    skipped  checks that find no occasion, and part of the reason that they give
    slow     the engine takes long to import or to compile
    ahead    the adapter begins blocks of captured steps before the ones ahead of them have arrived
    xla      XLA_FLAGS that halve the time in which XLA compiles; what the checks find is the same
    """

    simulator: str
    options: tuple[str, ...] = ()
    fails: dict[str, str] = field(default_factory=dict)
    skipped: dict[str, str] = field(default_factory=dict)
    slow: bool = True
    ahead: bool = False
    xla: str = ""

    @property
    def name(self) -> str:
        """For the test's id."""
        return " ".join((self.simulator, *self.options))


VARIANTS = (
    Variant("mujoco", skipped=_NO_BUFFERS, slow=False),
    Variant("mujoco", ("cone=pyramidal", "integrator=Euler"), skipped=_NO_BUFFERS),
    Variant("warp", ahead=True),
    Variant("mjx", ("impl=jax",), ahead=True),
    Variant("mjx", ("impl=warp",), skipped=_NO_PARAMETERS, ahead=True),
    Variant("playground", ahead=True),
    Variant(
        "brax",
        ("solver=positional",),
        fails={
            "stack_at_rest_stays": _SINKS,
            "contacts_hold_up_the_stack": _SINKS,
            "ball_rolls_down_the_slope": "accelerates at 1.85 m/s2 instead of 2.40",
        },
        ahead=True,
        xla=UNOPTIMISED,
    ),
    Variant(
        "brax",
        ("solver=spring",),
        fails={
            "stack_at_rest_stays": _SINKS,
            "ball_rolls_down_the_slope": "sinks into the slope: its path is 4 degrees steeper",
        },
        ahead=True,
        xla=UNOPTIMISED,
    ),
    Variant("newton", ("solver=mujoco",), ahead=True),
    Variant(
        "newton",
        ("solver=xpbd",),
        fails={
            "stack_at_rest_stays": _SINKS,
            "ball_rolls_down_the_slope": "accelerates at 2.21 m/s2 instead of 2.40",
        },
        ahead=True,
    ),
    Variant("newton", ("solver=steel",), ahead=True),
    Variant("genesis", ahead=True),
    Variant("physx", skipped={**_NO_COUNTS, **_NO_BUFFERS, **_PARTIAL_STATE}, ahead=True),
    Variant("physx", ("spacing=1000",), skipped={**_NO_COUNTS, **_NO_BUFFERS, **_PARTIAL_STATE}, ahead=True),
    Variant("isaaclab", ("backend=ovphysx",), skipped={**_NO_COUNTS, **_NO_BUFFERS, **_PARTIAL_STATE}, ahead=True),
    Variant(
        "isaaclab",
        ("backend=ovphysx", "spacing=1000"),
        skipped={**_NO_COUNTS, **_NO_BUFFERS, **_PARTIAL_STATE},
        ahead=True,
    ),
    Variant("isaaclab", ("backend=newton",), ahead=True),
    Variant("sapien", skipped={**_NO_BITS, **_NO_BUFFERS, **_PARTIAL_STATE}),
    Variant(
        "calibration",
        fails={"contacts_hold_up_the_stack": "a cube is a sphere, with one point of contact"},
        skipped={**_NO_BITS, **_NO_BUFFERS, **_NO_ORIENTATION},
    ),
)


ELSEWHERE = {"madrona", "maniskill"}
"""Simulators that need a module of the user's, or have one environment on a CPU: their own tests hold them to it."""


@cache
def _checked(variant: str, xla: str) -> subprocess.CompletedProcess[str]:
    simulator, *options = variant.split(" ")
    given = [word for option in options for word in ("--option", option)]
    command = [sys.executable, "-m", "gpusimbench.recorder.conformance", "--sim", simulator, *given, "--json"]
    env = {**os.environ, "XLA_FLAGS": xla} if xla else None
    return subprocess.run(command, capture_output=True, text=True, env=env)


def verdict(variant: Variant, check: str) -> dict[str, Any]:
    """What `python -m gpusimbench.recorder.conformance` finds; it runs once for all checks of a variant."""
    done = _checked(variant.name, variant.xla)
    assert done.returncode in (0, 1), f"exit code {done.returncode}: {done.stderr[-2000:]}"
    return next(v for v in json.loads(done.stdout)["checks"] if v["check"] == check)


def _cases() -> list[Any]:
    return [
        pytest.param(variant, check.__name__, id=f"{variant.name}-{check.__name__}", marks=marks)
        for variant in VARIANTS
        for marks in [[pytest.mark.slow] if variant.slow else []]
        for check in CHECKS
    ]


@pytest.mark.parametrize(("variant", "check"), _cases())
def test_conforms(variant: Variant, check: str) -> None:
    """Pass the check, or fail and skip as the table says."""
    if (missing := find_simulator(variant.simulator).missing()) and find(variant.simulator) is None:
        pytest.skip(f"not installed, and no environment is set up: {', '.join(missing)}")
    found = verdict(variant, check)
    if reason := variant.fails.get(check):
        assert found["outcome"] == "failed", (
            f"known to fail ({reason}), and it is {found['outcome']}: correct the table"
        )
        pytest.xfail(f"{reason}: {found['reason']}")
    if found["outcome"] == "skipped" and found["reason"].startswith(_VARYING):
        pytest.skip(found["reason"])
    expected = dict(variant.skipped)
    if not variant.ahead:
        expected["blocks_ahead_are_the_same"] = "begin_states is not overridden"
    if variant.simulator != "warp":
        expected["flights_hold_the_captured_states"] = "flight is not overridden"
    adapter = find_simulator(variant.simulator).adapter()
    options = parse_options(variant.simulator, adapter.Options, dict(given.split("=") for given in variant.options))
    abilities = adapter.abilities - adapter.withheld(options).keys()
    if Ability.VARIED_MASS not in abilities:
        expected |= _NO_PARAMETERS
    if Ability.ACTIONS not in abilities:
        expected["actions_are_those_drawn"] = "any built-in scene with actions needs"
    if reason := expected.get(check):
        assert found["outcome"] == "skipped", f"known to be skipped ({reason}), and it is {found['outcome']}"
        assert reason in found["reason"]
        pytest.skip(found["reason"])
    assert found["outcome"] == "ok", found["reason"]


def test_every_simulator_is_held_to_it() -> None:
    """Leave no registered simulator out of the table, and name no check in it that there is not."""
    assert {entry.name for entry in BUILT_IN} == {variant.simulator for variant in VARIANTS} | ELSEWHERE
    checks = {check.__name__ for check in CHECKS}
    for variant in VARIANTS:
        assert {*variant.fails, *variant.skipped} <= checks
