"""PhysX's shared libraries and USD schemas, loaded once in a process."""

from __future__ import annotations

import ctypes
import functools
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path

from gpusimbench.schemas.errors import GsbError, UsageError

_SCHEMAS = ("PhysxSchema", "OmniUsdPhysicsDeformableSchema")  # the engine asks for both

# what the engine warns of though this is the way to set it, and though nothing of it concerns a recording
_EXPECTED = ("PhysX\\(config=", "ovphysx is in CPU-only mode", "ovphysx tensor bindings are deprecated")


@functools.cache
def load() -> None:
    """Load what the engine consists of and register its schemas, before any USD is read.

    UsageError where a shared library is missing.
    """
    try:
        import ovphysx
        import ovstage

        # ovphysx does the same, and where it fails names this library alone, not the one that was missing
        ctypes.CDLL(str(Path(ovstage.__file__).parent / "bin" / "libovstage.so"), mode=ctypes.RTLD_GLOBAL)
        ovstage.population.register_usd_schemas([*_schema_folders(), str(ovphysx.newton_schema_root())])
    except (OSError, ImportError, RuntimeError) as error:
        text = " ".join(str(error).split())
        raise UsageError(
            f"simulator 'physx' cannot load its shared libraries and schemas: {text} (they come with ovphysx, ovstage, "
            "physx-usd-schemas and newton-usd-schemas, and need the system's libGL, libX11 and libXt, headless too)"
        ) from None


def _schema_folders() -> list[str]:
    # found without importing the package, which would load another USD
    package = metadata.distribution("physx-usd-schemas")
    return [str(package.locate_file(f"physx_usd_schemas/{name}/resources")) for name in _SCHEMAS]


def choose_processor(*, gpu: bool) -> None:
    """Keep the engine from the GPU, or not; before its first instance. GsbError where it was kept from it already."""
    from ovphysx import PhysX

    if gpu and PhysX.get_cpu_mode():
        raise GsbError("PhysX was kept to the CPU in this process, for as long as it lasts: use a fresh process")
    if not gpu and not PhysX.get_cpu_mode():
        PhysX.set_cpu_mode(True)


@contextmanager
def quiet() -> Iterator[None]:
    """Without the engine's warnings that are no news."""
    with warnings.catch_warnings():
        for message in _EXPECTED:
            warnings.filterwarnings("ignore", message=message)
        yield


def version() -> str:
    """The version of the engine, as distributed."""
    return metadata.version("ovphysx")


def versions() -> dict[str, str]:
    """Versions of what the engine is made of and read with."""
    return {name: metadata.version(name) for name in ("ovphysx", "ovstage", "physx-usd-schemas", "newton-usd-schemas")}
