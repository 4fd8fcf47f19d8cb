"""The engine conforms, and its scene comes to rest."""

from __future__ import annotations

import numpy as np
import pytest
from ballistic.adapter import Ballistic, Options
from ballistic.engine import World
from ballistic.scenes import EDGE, tilted_dice

from gpusimbench.recorder.conformance import CHECKS, NotApplicable, Subject
from gpusimbench.testing import assert_batch_invariant, assert_deterministic


@pytest.fixture(scope="session")
def subject() -> Subject:
    """One subject, so that all checks share its builds; of the installed package, and recorded as well."""
    return Subject.named("ballistic")


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_conforms(subject, check):
    """Pass the check."""
    try:
        check(subject)
    except NotApplicable as reason:
        pytest.skip(str(reason))


def test_dice_come_to_rest():
    """Let the dice lie flat on the table after 1.5 s, each world alike."""
    simulator = Ballistic(tilted_dice(), n_env=2, dt=0.01, seed=0, options=Options())
    fields = [field.field for field in simulator.build().fields]
    simulator.step(150)
    state = dict(zip(fields, simulator.state(), strict=True))
    assert np.allclose(state["position"][..., 2], EDGE / 2, atol=1e-4)
    assert np.abs(state["linear_velocity"]).max() < 1e-3
    assert all(array[0].tobytes() == array[1].tobytes() for array in state.values())


def test_dice_stay_above_the_table():
    """Let no die's centre come closer to the table than 8 mm, two less than where it rests, at any impact."""
    simulator = Ballistic(tilted_dice(), n_env=1, dt=0.01, seed=0, options=Options())
    simulator.build()
    lowest = min(simulator.states(1)[0][..., 2].min() for _ in range(60))
    assert lowest > EDGE / 2 * 0.8


class Dice:
    """n worlds with dice that are thrown; world i by the seed plus i."""

    def __init__(self, n_env):
        self.n_env = n_env

    def reset(self, seed):
        self.world = World(tilted_dice(), self.n_env)
        for env in range(self.n_env):
            self.world.velocity[env, : self.world.moving] += np.random.default_rng(seed + env).uniform(-1, 1, 3)
        return self.state()

    def step(self, action):
        self.world.step(0.01, substeps=40)
        return self.state()

    def state(self):
        world = self.world
        return {"position": world.position, "orientation": world.orientation, "velocity": world.velocity}


def test_the_engine_repeats_itself():
    """Throw dice twice and get the same bits."""
    assert_deterministic(lambda: Dice(2), steps=40)


def test_worlds_do_not_feel_each_other():
    """Throw the same dice in one world, and beside others, and get the same bits."""
    assert_batch_invariant(Dice, steps=40, numbers=(1, 2, 3))
