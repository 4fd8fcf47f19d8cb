"""The formats of data sets."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gpusimbench.recorder.demonstrations import hdf5, lerobot, maniskill, robomimic
from gpusimbench.recorder.demonstrations.data_set import DataSet
from gpusimbench.schemas.errors import UsageError

FORMATS: tuple[Callable[[Path], DataSet | None], ...] = (
    lerobot.opened,
    maniskill.opened,
    robomimic.opened,
    hdf5.opened,
)
"""Each returns the data set at a path, or None where it is not of the format."""


def data_set_at(path: Path) -> DataSet | None:
    """The data set at a path; None where a file is none. UsageError for a folder of no format."""
    found = next((found for opened in FORMATS if (found := opened(path))), None)
    if found is None and path.is_dir():
        raise UsageError(
            f"{path} is a folder without {hdf5.MINARI_FILE} (Minari) and {lerobot.INFO} (LeRobot): give the folder of "
            "a data set, or a file"
        )
    return found
