"""How large an engine's contact buffers must be, measured on MuJoCo C before the engine is built.

The same model is stepped there once, for as long as the protocol runs, and what it needs is counted; the engine gets
that and a margin. Whether it was enough is counted again by the engine itself, at every step: an overflow makes the run
invalid.
"""

from __future__ import annotations

from dataclasses import dataclass

from recorder.simulators.mjcf_model import MjcfModel

_PROTOCOL_STEPS = 1100  # warm-up and timed steps
_PILOT_ENVS = 64  # of a scene whose environments are given different actions
_MARGIN = 1.1  # over one trajectory that all environments repeat, rounding aside
_MARGIN_OF_SAMPLE = 1.5  # over a sample of trajectories, of which many more will be run
_ROUND = 32


@dataclass(frozen=True)
class Need:
    """What MuJoCo C needed at its fullest step.

    contacts  in one environment
    rows      of constraints in one environment
    steps     that were counted
    envs      that were counted
    margin    by which buffers should be larger
    """

    contacts: int
    rows: int
    steps: int
    envs: int
    margin: float

    def size(self, needed: int) -> int:
        """The buffer for what was needed."""
        return max(_ROUND, -(-int(needed * self.margin) // _ROUND) * _ROUND)

    def sized_by(self, needed: int) -> str:
        """How the size came about."""
        what = f"{self.envs} envs of MuJoCo C" if self.envs > 1 else "MuJoCo C"
        return (
            f"{needed} needed by {what} in {self.steps} steps, times {self.margin:g}, to the next multiple of {_ROUND}"
        )


def measure(compiled: MjcfModel, *, dt: float, seed: int) -> Need:
    """Count what the scene needs over the protocol's steps, or its sample time where that is longer."""
    steps = max(_PROTOCOL_STEPS, round(compiled.scene.sample_time / dt))
    drawn = compiled.scene.actions is not None
    envs = _PILOT_ENVS if drawn else 1
    contacts = rows = 0
    for data in compiled.rollout(n_step=steps, seed=seed, n_env=envs):
        contacts, rows = max(contacts, data.ncon), max(rows, data.nefc)
    return Need(contacts, rows, steps, envs, _MARGIN_OF_SAMPLE if drawn else _MARGIN)
