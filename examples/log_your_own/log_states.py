"""A program that has states of its own and logs them as a recording: python log_states.py FILE.mcap [RUN]

Three balls a world are thrown and bounce. The program knows no base class; all that it needs is RecordingWriter.
"""

import sys
import time

import numpy as np

from gpusimbench.recorder.log import RecordingWriter
from gpusimbench.schemas.fields import body_field

N_ENV, STEPS, TIMED, DT = 8, 100, 500, 0.01
NAMES = ("red", "green", "blue")
GRAVITY = np.float32(-9.81)


class Toss:
    """The program's own simulation: position and velocity [env, ball, 3], float32."""

    def __init__(self):
        start = np.array([[0.1 * i, 0, 1 + 0.2 * i] for i in range(len(NAMES))], dtype=np.float32)
        self.position = np.repeat(start[None], N_ENV, axis=0)
        self.velocity = np.zeros_like(self.position)
        self.velocity[..., 0] = 0.5

    def step(self):
        self.velocity[..., 2] += np.float32(DT) * GRAVITY
        self.position += np.float32(DT) * self.velocity
        down = (self.position[..., 2] < 0) & (self.velocity[..., 2] < 0)
        self.velocity[..., 2][down] *= np.float32(-0.8)


def time_steps():
    """Clocks of each step of a simulation that nothing else is done with [ns]."""
    toss, clocks = Toss(), np.empty((2, TIMED), dtype=np.int64)
    for k in range(TIMED):
        clocks[0, k] = time.perf_counter_ns()
        toss.step()
        clocks[1, k] = time.perf_counter_ns()
    return clocks


toss = Toss()
fields = tuple(body_field("cubes", field, "float32", NAMES) for field in ("position", "linear_velocity"))
with RecordingWriter(
    sys.argv[1], run_index=int(sys.argv[2]) if len(sys.argv) > 2 else 0,
    simulator="toss", version="1.0", scene="three-balls", n_env=N_ENV, dt=DT, steps=STEPS, fields=fields,
    timed_steps=TIMED, timing_covers="one step of all worlds", options={"rebound": 0.8},
    switches={"precision": "float32"},
) as log:  # fmt: skip
    log.clocks(*time_steps())
    log.append(toss.position, toss.velocity)  # the first state, at step 0
    for _ in range(STEPS):
        toss.step()
        log.append(toss.position, toss.velocity)
