"""What commands print: lines, blocks of lines, and documents for programs."""

from __future__ import annotations

import re
import sys

from gpusimbench.schemas.printable import Block, Line


def show(text: Line | Block, *, error: bool = False) -> None:
    """Print a line, or lines, on standard output, or on standard error; whoever reads them gets them at once."""
    stream = sys.stderr if error else sys.stdout
    stream.write(text if isinstance(text, Block) else f"{text}\n")
    stream.flush()


def show_document(text: str) -> None:
    """Print JSON on standard output. What a CI service takes for a command is written as JSON's own escape."""
    sys.stdout.write(re.sub("#(?=#)", r"\\u0023", text))
