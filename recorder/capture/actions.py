"""Actions of the capture phase to blocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.ranges import Ranges
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.capture.workers import Workers
from gpusimbench.schemas import topics
from gpusimbench.schemas.action_generator import GENERATOR, JointTargets, Streams, describe_generator, expect
from gpusimbench.schemas.block_parts import action_parts, generated_action
from gpusimbench.schemas.configuration import sim_time_ns
from gpusimbench.schemas.errors import DataLost
from gpusimbench.schemas.mcap.writer import Part

Actions = Callable[[range], NDArray[np.float32]]
"""What is applied in consecutive steps to the environments of a range, [step, env, action]."""

Told = Callable[[slice], NDArray[np.float32] | None]
"""What an engine held in these steps; None where it does not tell."""


class ActionWriter:
    """Writes the actions of the capture phase: as their generator, where that draws what the engine held, bit for bit.

    Digests are of the arrays in either case.
    """

    def __init__(
        self, sink: Sink, workers: Workers, actions: JointTargets, *, seed: int, streams: Streams, dt: float,
        n_step: int,
    ) -> None:  # fmt: skip
        """streams  of all environments
        n_step   how many steps will be written
        """
        self._sink = sink
        self._workers = workers
        self._name = actions.name
        self._streams = streams
        self._dt = dt
        n_env, generator = len(streams.env), describe_generator(actions, seed)
        self._generated = bool(generator)
        if generator:
            expect(n_step * n_env * len(actions.joints) * np.dtype(np.float32).itemsize)
        self._blocks = Ranges(n_env).each
        metadata = {
            "shape": "step,env,joint",
            "joints": ",".join(actions.joints),
            "unit": actions.unit,
            "dtype": "float32",
            "meaning": actions.meaning,
            **({GENERATOR: generator} if generator else {}),
        }
        for envs in self._blocks:
            sink.channel(topics.action(actions.name, envs.start), "gsb.v1.ActionBlock", metadata)

    def write(self, drawn: Actions, told: Told, first_step: int) -> None:
        """Actions of consecutive steps, the first of them leading on from the state of `first_step`."""
        self.begin(drawn, told, first_step)()

    def begin(self, drawn: Actions, told: Told, first_step: int) -> Callable[[], None]:
        """The same, by what is returned; other threads, where there are any, begin now, and feed the digests."""
        time = sim_time_ns(first_step, self._dt)
        digested: list[range] = []

        def encoded(envs: range) -> Sequence[Part]:
            held = told(slice(envs.start, envs.stop))
            array = drawn(envs) if held is None else held
            generated = self._generated and (held is None or _same_bits(held, drawn(envs)))
            parts = action_parts(array, first_step=first_step, stride=1, env_start=envs.start, sim_time_ns=time)
            digested.append(envs)
            self._sink.digest.message(topics.action(self._name, envs.start), *(part.data for part in parts))
            if generated:
                return [Part(generated_action(parts, self._streams.of(envs), envs.start))]
            return parts

        alone, blocks = self._workers.alone, self._workers.later(encoded, self._blocks)

        def end() -> None:
            try:
                for envs, parts in zip(self._blocks, blocks(), strict=True):
                    self._sink.write_parts(topics.action(self._name, envs.start), parts, sim_ns=time)
                self._sink.flush()
            except DataLost:
                raise
            except Exception as error:
                if alone and not digested:
                    raise
                # some are digested, or will be by other threads, and not written
                raise self._sink.lost(error) from error

        return end


def _same_bits(one: NDArray[np.float32], other: NDArray[np.float32]) -> bool:
    return one.dtype == other.dtype and np.array_equal(one.view(np.uint32), other.view(np.uint32))
