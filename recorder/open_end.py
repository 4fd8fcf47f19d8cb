"""Recordings whose number of steps is known only when they end."""

from __future__ import annotations

from dataclasses import replace

from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.provenance import PROVENANCE, Provenance


def closed(sink: Sink, provenance: Provenance, last_step: int) -> RunConfiguration:
    """Write the number of steps into the provenance, which lies at the beginning of the file; spaces fill it up.

    last_step  that was recorded; a recording without one has the fewest steps that there can be

    Returns the configuration with that number.
    """
    before = provenance.configuration
    configuration = replace(before, steps=max(before.stride, last_step))
    data = replace(provenance, configuration=configuration).to_json().encode()
    sink.rewrite(PROVENANCE, data.ljust(len(provenance.to_json().encode())))
    return configuration
