"""Whether two sides hold the same bodies in another order, within environments or also in other environments."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.diff.selection import Selection
from gpusimbench.evaluator.diff.states import CommonStates
from gpusimbench.schemas.fingerprint import fingerprint
from gpusimbench.schemas.mixing import GOLDEN, mix

Words = NDArray[np.uint64]


class BodyOrder:
    """Bodies by 64-bit hashes of all their numbers at a state, which are held against each other in any order.

    The bodies of a group, which has positions, may be in any order within their environment, at every recorded state in
    another one; items of other groups, such as joints, keep theirs. Environments keep their places in time.

    in_env     every environment has the bodies of its counterpart
    any_env    the environments of b have the bodies of those of a, each as often; False where not all are compared
    """

    def __init__(self, states: CommonStates, a: Selection, b: Selection) -> None:
        self._states = states
        self._placed = {how.field.a.group for how in states.fields if how.field.is_position}
        whole = all(len(side.envs) == side.recording.configuration.n_env for side in (a, b))
        self.in_env, self.any_env = True, whole and len(a.envs) == len(b.envs)
        self._trajectories = tuple(np.zeros(len(side.envs), dtype=np.uint64) for side in (a, b))

    def look(self) -> None:
        """Read the common states until neither can hold any more: of sides that differ otherwise, a chunk or two."""
        for rows in self._states.ranges():
            a, b = self._bodies(rows)
            self.in_env = self.in_env and a.shape[2:] == b.shape[2:] and bool((a == b).all())
            if self.any_env:
                found = [_followed(t, side) for t, side in zip(self._trajectories, (a, b), strict=True)]
                self._trajectories = tuple(found)
                self.any_env = np.array_equal(np.sort(found[0]), np.sort(found[1]))
            if not (self.in_env or self.any_env):
                return

    def _bodies(self, rows: slice) -> tuple[Words, Words]:
        """Hashes of the bodies of both sides, in order where that may be another, [step, env, item]."""
        sides: list[dict[tuple[str, int], Words]] = [{}, {}]
        for index, how in enumerate(self._states.fields):
            has = self._states.has(index, rows)
            key = np.uint64((index + 1) * GOLDEN & 0xFFFFFFFFFFFFFFFF)
            for side, array in zip(sides, self._states.read(index, rows), strict=True):
                # fields of a group that have other items are bodies of their own
                hashes = np.zeros((len(has), *array.shape[1:3]), dtype=np.uint64)
                hashes[has] = mix(fingerprint([array[..., np.newaxis, :]]) + key)
                of = how.field.a.group, array.shape[2]
                side[of] = side[of] + hashes if of in side else hashes
        a, b = (np.concatenate([self._sorted(group, h) for (group, _), h in s.items()], axis=2) for s in sides)
        return a, b

    def _sorted(self, group: str, hashes: Words) -> Words:
        return np.sort(hashes, axis=2) if group in self._placed else hashes


def _followed(trajectories: Words, bodies: Words) -> Words:
    """Trajectories of environments so far, shape [env], and on by some states of their bodies."""
    for row in fingerprint([bodies.view(np.float64)[..., np.newaxis]]):
        trajectories = mix((trajectories + np.uint64(GOLDEN)) ^ row)
    return trajectories
