"""Whether what came of a spoiled recording is what was promised."""

from __future__ import annotations

from pathlib import Path

from gpusimbench import open_recording
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.schemas.errors import GsbError
from tests.hostile.mutate import Mutant, Promise
from tests.hostile.reading import first_states, in_time, seen, use

_BEYOND_THE_HASH = {"cause"}
"""Parts of the end record that the content hash does not cover."""


class Broken(AssertionError):
    """A promise was not kept."""


class Judge:
    """Reads mutants of a corpus as a user would.

    path  where each of them lies while it is read
    """

    def __init__(self, corpus: list[Path], path: Path) -> None:
        self.path = path
        self._files = corpus
        self.corpus = [file.read_bytes() for file in corpus]
        self._recordings = [open_recording(file) for file in corpus]
        self._seen = [seen(recording) for recording in self._recordings]

    def read(self, mutant: Mutant, turn: int) -> str:
        """What came of it: "refused", "incomplete" or "the same". Broken where that is not as promised.

        turn  in which of several ways it is used
        """
        self.path.write_bytes(mutant.data)
        with in_time():
            outcome = self._outcome(mutant)
        use(self.path, self._files[mutant.original], turn)
        return outcome

    def _outcome(self, mutant: Mutant) -> str:
        original = self._recordings[mutant.original]
        try:
            recording = open_recording(self.path)
            verify(recording)
            if recording.status == "incomplete" and mutant.promise is not Promise.SAME:
                if mutant.prefix:
                    self._check_prefix(recording, original)
                return "incomplete"
            found = seen(recording)
        except GsbError as error:
            if mutant.promise is Promise.SAME:
                raise Broken(f"no change of content, and refused: {error}") from None
            return "refused"
        if mutant.promise is Promise.FORGED:
            return "accepted"
        expected = self._seen[mutant.original]
        differing = {name for name in expected.keys() | found.keys() if expected.get(name) != found.get(name)}
        if mutant.promise is Promise.BEYOND_THE_HASH:
            differing -= _BEYOND_THE_HASH
        if differing and found in self._seen:
            return "another, whole"
        if differing:
            raise Broken(f"accepted, and not the original's: {', '.join(sorted(differing))}")
        return "the same"

    def _check_prefix(self, recording: Recording, original: Recording) -> None:
        # what is there of an incomplete recording is what was written, from the first step on
        for field in recording.fields:
            try:
                array = recording.state(field.group, field.field)
                rows = int(array.steps[-1]) + 1 if len(array) else 0
                mine, theirs = (first_states(r, rows)[field.name] for r in (recording, original))
            except GsbError:
                continue
            if mine != theirs:
                raise Broken(f"the states of {field.name} are not those that were written")
