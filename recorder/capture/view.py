"""What viewers draw of a few environments, made of the states as these are written."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.captured import States
from gpusimbench.schemas.checks import load
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.view.foxglove import event_line, status_line
from gpusimbench.schemas.view.geometry import GEOMETRY, look_of
from gpusimbench.schemas.view.recorded import LOG_TOPIC, LOG_TYPE, METADATA, RecordedView, ViewMessage, layout_of


class ViewWriter:
    """Writes the view of some environments: shapes at once, poses with each block of states.

    attachments  of the recording: name -> (media type, bytes)

    DamagedRecording where states, scene or geometry are nothing that can be shown; nothing is written then.
    """

    def __init__(
        self,
        sink: Sink,
        configuration: RunConfiguration,
        *,
        fields: Sequence[StateField],
        scene: Scene | None,
        attachments: Mapping[str, tuple[str, bytes]],
        env_origins: Sequence[tuple[float, float, float]],
    ) -> None:
        c = configuration
        described = json.loads(scene.to_json()) if scene is not None else {}
        attached = attachments.get(GEOMETRY)
        look = look_of(described, load(GEOMETRY, attached[1]) if attached else None)
        self._sink = sink
        self._views = [
            RecordedView(env, fields=fields, look=look, env_origins=env_origins, dt=c.dt, stride=c.stride)
            for env in c.view
        ]
        self._indexes = [fields.index(field) for field in self._views[0].fields]
        scenes = [view.scene() for view in self._views]
        sink.metadata(METADATA, {"environments": ",".join(map(str, c.view)), "layout": layout_of(self._views)})
        for view in self._views:
            for topic, kind in view.types.items():
                sink.channel(topic, kind)
        for scene_message in scenes:
            self._write(scene_message)

    def rows(self, first_row: int, columns: Sequence[States], envs_of: int) -> None:
        """Consecutive recorded rows.

        columns  by range of environments: arrays [row, env of the range, item, width], one a field
        envs_of  environments in each range but the last
        """
        for view in self._views:
            column, env = divmod(view.env, envs_of)
            shown = slice(-first_row % view.one_of, None, view.one_of)
            states = [columns[column][index][shown, env] for index in self._indexes]
            rows = range(first_row + shown.start, first_row + len(columns[column][0]), view.one_of)
            for message in view.rows(rows, states):
                self._write(message)

    def _write(self, message: ViewMessage) -> None:
        self._sink.view(message.topic, message.message.SerializeToString(), log_time=message.log_time)


class LogWriter:
    """Writes the events of a run as lines that viewers show, where the run has a view."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._last_ns = 0
        sink.channel(LOG_TOPIC, LOG_TYPE)

    def event(self, kind: str, event: Any) -> None:
        """An event of the run, a gsb.v1.Event, and the name of its kind."""
        self._last_ns = event.unix_ns
        self._write(event_line(kind, event.phase, event.text, event.unix_ns))

    def status(self, status: str, reason: str) -> None:
        """How the run ended."""
        self._write(status_line(status.lower(), reason, self._last_ns, good=status == "COMPLETE"))

    def _write(self, line: Any) -> None:
        self._sink.view(LOG_TOPIC, line.SerializeToString())
