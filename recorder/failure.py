"""What kind of thing ended a run: the Cause of its end record."""

from __future__ import annotations

from gpusimbench.schemas.errors import GsbError, UsageError

_HOST_MEMORY = ("std::bad_alloc", "could not allocate memory")  # MuJoCo C, as ValueError or FatalError
_DEVICE_MEMORY = (
    "resource_exhausted",  # XLA
    "out of memory",  # CUDA, torch
    "cudaerrormemoryallocation",
    "cuda_error_out_of_memory",
    "failed to allocate",  # Warp
)


class Refused(GsbError):
    """The engine does not accept a setting that it was given: an outcome worth recording, with its reason."""


class TimedOut(GsbError):
    """The run took longer than it may."""


class NoHostMemory(GsbError):
    """The machine has not the memory that something asks for."""


class Interrupted(GsbError):
    """The user, or the system, ended the run."""


def cause_of(error: BaseException) -> str:
    """What ended a run, by the name that gsb.v1.Cause has for it."""
    match error:
        case KeyboardInterrupt() | Interrupted():
            return "INTERRUPTED"
        case TimedOut():
            return "TIMEOUT"
        case Refused() | UsageError():
            return "REFUSED"
        case MemoryError() | NoHostMemory():
            return "HOST_MEMORY"
    text = f"{type(error).__name__} {error}".lower()
    if any(words in text for words in _DEVICE_MEMORY):
        return "DEVICE_MEMORY"
    if any(words in text for words in _HOST_MEMORY):
        return "HOST_MEMORY"
    return "ENGINE"


_OLD_ROOTS = ("evaluator", "recorder", "schemas")


def in_words(error: Exception) -> str:
    """What a third party's code raised, in one line, and what to import where a package is named as it was."""
    text = " ".join(f"{type(error).__name__}: {error}".split())
    name = error.name if isinstance(error, ModuleNotFoundError) else None
    if name and name.partition(".")[0] in _OLD_ROOTS:
        text += f"; import gpusimbench.{name} instead (docs/python.md lists what has moved)"
    return text
