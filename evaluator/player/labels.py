"""What recordings and their environments are called beside each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.provenance import engine_name
from gpusimbench.schemas.text import printable


@dataclass(frozen=True)
class Labels:
    """Names of what is shown together.

    title    the simulator, its version and the scene
    whose    "environments", or "environments of 3 recordings"
    sources  one a recording: empty where there is but one, "run 3", or a letter where runs have the same number
    lettered whether they are letters
    """

    title: str
    whose: str
    sources: tuple[str, ...]
    lettered: bool

    def track(self, recording: int, env: int) -> str:
        """An environment in words."""
        source = self.sources[recording]
        return f"env {env} of {source}" if source else f"env {env}"

    def short(self, recording: int, env: int) -> str:
        """An environment in a small place."""
        source = self.sources[recording].removeprefix("run ")
        return f"{source}·{env}" if source else str(env)

    @property
    def numbers(self) -> str:
        """What the parts of a short name are."""
        source = "recording" if self.lettered else "run"
        return f"{source} · environment" if self.sources[0] else "environment"

    def legend(self, recordings: Sequence[Recording]) -> str:
        """Which file has which letter."""
        pairs = zip(self.sources, recordings, strict=True)
        return "recording " + ", ".join(f"{source} is {recording.path.name}" for source, recording in pairs)


def labels_of(recordings: Sequence[Recording]) -> Labels:
    """Names for recordings of one scene."""
    kinds = dict.fromkeys(_kind(recording) for recording in recordings)
    title = f"{' and '.join(kinds)}: {recordings[0].configuration.scene}"
    if len(recordings) == 1:
        return Labels(printable(title), "environments", ("",), False)
    runs = [recording.configuration.run_index for recording in recordings]
    if len(kinds) == 1 and len(set(runs)) == len(runs):
        return Labels(printable(title), f"environments of {len(runs)} runs", tuple(f"run {run}" for run in runs), False)
    return Labels(
        printable(title), f"environments of {len(runs)} recordings", tuple(map(_letter, range(len(runs)))), True
    )


def _kind(recording: Recording) -> str:
    version = recording.simulation.version if recording.simulation else ""
    return f"{engine_name(recording.configuration.simulator, recording.simulation)} {version}".strip()


def _letter(index: int) -> str:
    return chr(ord("a") + index) if index < 26 else f"file {index + 1}"
