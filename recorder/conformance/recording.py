"""A recording as the checks look at it, read with the mcap library alone."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any

from mcap.reader import make_reader

from gpusimbench.recorder.process.launch import Result
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.messages import message_class


@dataclass(frozen=True)
class RecordedRun:
    """A run that was recorded.

    configuration  what was asked
    status         complete, invalid, failed or incomplete; `reason` says why
    messages       by topic, in order: serialised messages
    schemas        name of each topic's message type
    attachments    by name
    """

    configuration: RunConfiguration
    status: str
    reason: str
    messages: dict[str, list[bytes]] = field(default_factory=dict)
    schemas: dict[str, str] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)

    def decoded(self, topic: str) -> list[Any]:
        """The messages of a topic, parsed."""
        return [message_class(self.schemas[topic]).FromString(data) for data in self.messages.get(topic, ())]


def read(configuration: RunConfiguration, result: Result) -> RecordedRun:
    """All of a recording; empty where there is none under its final name."""
    run = RecordedRun(configuration, result.status, result.reason, defaultdict(list))
    if result.path is None or result.status == "incomplete":
        return run
    with result.path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        for channel in summary.channels.values():
            run.schemas[channel.topic] = summary.schemas[channel.schema_id].name
        for _, channel, message in reader.iter_messages(log_time_order=False):
            run.messages[channel.topic].append(message.data)
        for attachment in reader.iter_attachments():
            run.attachments[attachment.name] = attachment.data
    return run
