"""Recorded actions as arrays, and as what their digests are of: drawn again where a generator stands for them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.read.messages import Messages
from gpusimbench.schemas import topics
from gpusimbench.schemas.action_generator import GENERATOR, Generator, read_generator
from gpusimbench.schemas.blocks import BlockHeader, decode_action, raw_action
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.digest import ContentDigest
from gpusimbench.schemas.errors import damage_in
from gpusimbench.schemas.fields import ENV, StateField
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.treatment import Intervention, alike

_HASH_BYTES = 8  # that a file has for each step of each environment, whatever else it keeps of it
_RATIO, _FREE_BYTES = 64, 8 << 20  # of these hashes compressed: environments of different actions have different ones

_T = TypeVar("_T")
_Block = NDArray[np.floating]  # [step, env, action]


def described_generator(topic: str, metadata: Mapping[str, str]) -> str | None:
    """What a channel of actions says of the generator that draws what its messages do not hold; None of all others."""
    return metadata.get(GENERATOR) if topics.parse_action(topic) else None


class ActionContents:
    """Blocks of actions of one file.

    All that one object draws is of no more steps and environments than the file can hold state hashes of.
    """

    def __init__(self, container: Container) -> None:
        self._container = container
        self._room = min(container.content_bytes, _FREE_BYTES + _RATIO * container.size) // _HASH_BYTES

    def arrays(self, topic: str) -> Iterator[tuple[BlockHeader, NDArray[np.floating]]]:
        """Headers and arrays [step, env, action] of a topic. DamagedRecording where a block cannot be read."""
        return self._each(topic, lambda content, generator: decode_action(content, generator, most=self._room))

    def digest(self, topic: str, digest: ContentDigest) -> None:
        """Feed a topic's messages to a digest as if they held their arrays, so that it does not depend on whether they
        do."""
        for _, parts in self._each(topic, lambda content, generator: raw_action(content, generator, most=self._room)):
            digest.message(topic, *parts)

    def _each(
        self, topic: str, read: Callable[[memoryview, Generator | None], tuple[BlockHeader, _T]]
    ) -> Iterator[tuple[BlockHeader, _T]]:
        described = described_generator(topic, self._container.channels[topic].metadata)
        generator = None if described is None else self._naming_topic(topic, lambda: read_generator(described))
        for content in self._container.in_sequence(topic):
            header, found = self._naming_topic(topic, partial(read, content, generator))
            if header.encoding:
                self._room -= header.steps * header.envs
            yield header, found

    def _naming_topic(self, topic: str, read: Callable[[], _T]) -> _T:
        with damage_in(f"{self._container.path}: {topic}"):
            return read()


def apart_by_design(acted: bool, fields: tuple[StateField, ...], configuration: RunConfiguration) -> str:
    """Why the environments of a run differ whatever its engine does; empty where they should be alike.

    acted   whether actions were applied
    fields  that were recorded
    """
    if any(field.group == ENV for field in fields):
        return "seeds and actions of environments differ by design"
    if acted and not alike(configuration.actions):
        return "the environments were given different actions, so they differ by design"
    if configuration.vary:
        return f"environments differ by --vary {configuration.vary}"
    if configuration.initial:
        return "the environments began in different states, so they differ by design"
    done, n_env = Intervention.of(configuration.intervention), configuration.n_env
    if done and done.kind.changes and len(done.treated(n_env)) < n_env:
        return "some environments were changed on the way, so they differ by design"
    return ""


def action_names(messages: Messages) -> tuple[str, ...]:
    """Names of the recorded action streams, in order of appearance."""
    parsed = (topics.parse_action(topic) for topic in messages.topics("/action/"))
    return tuple(dict.fromkeys(p.name for p in parsed if p))


def read_actions(
    messages: Messages, name: str, *, n_env: int, first_step: int, cut_short: bool
) -> NDArray[np.floating]:
    """A stream of actions, shape [step, env, action]; row i leads from row i of the states to the next.

    first_step  of the capture
    cut_short   steps that not every environment has are left out, instead of being damage

    KeyError names the recorded streams. DamagedRecording where steps or environments are missing.
    """

    def kept(block: NDArray[np.floating]) -> NDArray[np.floating]:
        return block if block.base is None else block.copy()  # a view would keep the whole chunk that it came from

    columns = _columns(messages, name, kept, n_env=n_env, first_step=first_step, cut_short=cut_short)
    if not columns:
        return np.empty((0, n_env, 0))
    steps = min(sum(map(len, rows)) for rows in columns)
    return np.concatenate([np.concatenate(rows)[:steps] for rows in columns], axis=1)


def check_actions(messages: Messages, name: str, *, n_env: int, first_step: int, cut_short: bool) -> None:
    """Read and check a stream of actions as `read_actions` does, a block at a time: nothing of its size is held."""

    def of_its_shape(block: NDArray[np.floating]) -> NDArray[np.floating]:
        return np.broadcast_to(np.zeros((), block.dtype), block.shape)

    _columns(messages, name, of_its_shape, n_env=n_env, first_step=first_step, cut_short=cut_short)


def _columns(
    messages: Messages, name: str, kept: Callable[[_Block], _Block], *, n_env: int, first_step: int, cut_short: bool
) -> list[list[_Block]]:
    # what is kept of the blocks, by range of environments; none where no step is there of all environments
    found = {p.env_start: t for t in messages.topics("/action/") if (p := topics.parse_action(t)) and p.name == name}
    if not found:
        known = ", ".join(action_names(messages)) or "none"
        raise KeyError(f"{messages.path} has no actions {name}; it has: {known}")
    starts = sorted(found)
    contents = ActionContents(messages.container)
    blocks = {start: _column(messages, contents, found[start], start, first_step, kept) for start in starts}
    if cut_short and not all(blocks.values()):
        return []
    kinds = {(block.dtype, block.shape[2]) for rows in blocks.values() for block in rows}
    if not kinds:
        return []
    counts = {start: sum(len(block) for block in rows) for start, rows in blocks.items()}
    if len(kinds) > 1 or (len(set(counts.values())) > 1 and not cut_short):
        raise messages.damaged(f"the actions {name} are of different kinds, or of different numbers of steps")
    for start, stop in zip(starts, [*starts[1:], n_env], strict=True):
        if starts[0] or any(block.shape[1] != stop - start for block in blocks[start]):
            raise messages.damaged(f"the actions {name} are not there once for every environment")
    return [blocks[start] for start in starts]


def _column(
    messages: Messages, contents: ActionContents, topic: str, env_start: int, first_step: int,
    kept: Callable[[_Block], _Block],
) -> list[_Block]:  # fmt: skip
    rows: list[_Block] = []
    expected = first_step
    for header, block in contents.arrays(topic):
        if (header.first_step, header.env_start) != (expected, env_start) or header.stride > 1:
            raise messages.damaged(f"actions from step {expected} on are missing in {topic}")
        rows.append(kept(block))
        expected += header.steps
    return rows
