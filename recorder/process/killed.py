"""The recording of a run whose process had to be killed after its timeout, written by the one that killed it.

It has no data. It says what the run was, as far as the run itself had written that, and that it failed; so nobody waits
for the same run a second time.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.environments.interpreter import Interpreter
from gpusimbench.recorder.plan import release, reserve
from gpusimbench.recorder.probes.gpu import Gpus
from gpusimbench.recorder.probes.host import describe_host
from gpusimbench.schemas.errors import RecordingError
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.provenance import PACKAGES, PROVENANCE, SCENE, SIMULATION, Provenance

_JSON = "application/json"
_SAID = {PROVENANCE: _JSON, PACKAGES: "text/plain", SCENE: _JSON, SIMULATION: _JSON}


def record_killed(
    folder: Path, provenance: Provenance, left: Path | None, interpreter: Interpreter, reason: str
) -> Path:
    """Write the recording; returns its path. DataLost where it cannot be written.

    left  what the run itself left behind: its .partial file, which stays as it is
    """
    said = dict(_attachments(left)) if left else {}
    configuration = provenance.configuration
    path = reserve(folder, configuration, provenance.created_utc)
    try:
        sink = Sink(path, compression=configuration.compression, reserved=True)
        try:
            if PROVENANCE not in said:
                with Gpus() as gpus:  # so that a sweep finds it again as made here
                    whole = replace(
                        provenance, host=describe_host(), gpus=gpus.describe(), software=interpreter.software()
                    )
                sink.attach(PROVENANCE, _JSON, whole.to_json().encode())
            for name, data in said.items():
                sink.attach(name, _SAID[name], data)
            return sink.finish("FAILED", reason, cause="TIMEOUT", last_step=0, peak_rss_bytes=0)
        except BaseException:
            sink.abandon()
            raise
    finally:
        release(path)


def _attachments(path: Path) -> Iterator[tuple[str, bytes]]:
    # as far as the file goes: a killed process may have left half a record behind
    try:
        container = Container(path)
    except RecordingError:
        return
    for name in _SAID:
        with suppress(RecordingError):
            data = container.attachment(name)
            if data is not None:
                yield name, data
