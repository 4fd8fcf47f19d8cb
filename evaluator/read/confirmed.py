"""Whether a recorder confirmed that a recording is on the disk: the name of a file that it did not ends in .partial."""

from __future__ import annotations

from gpusimbench.schemas import PARTIAL
from gpusimbench.schemas.location import Place


def unconfirmed(path: Place) -> str:
    """A sentence on a file that has an end record, and still the name under which it was written; empty for others.

    The end record is written before the flush to the disk and the renaming. If the flush fails, what is read here can
    be whole because the operating system still has it in memory, and be lost when the machine is restarted.
    """
    if not path.name.endswith(PARTIAL):
        return ""
    return f"not confirmed by its recorder to be on the disk: its name still ends in {PARTIAL}"
