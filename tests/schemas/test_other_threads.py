"""What a command prints, beside libraries that print too."""

from __future__ import annotations

import io
import sys
from contextlib import redirect_stdout
from threading import Thread

from gpusimbench.schemas.commands.output import OfMainThread


def test_other_threads_print_nothing() -> None:
    """Keep the words of a library's threads out of a command's output, and tell the threads that they were written."""
    kept, written = io.StringIO(), list[int]()
    with redirect_stdout(OfMainThread(kept)):
        print("ours")
        thread = Thread(target=lambda: written.append(sys.stdout.write("theirs")))
        thread.start()
        thread.join()
        print("ours again")
    assert (kept.getvalue(), written) == ("ours\nours again\n", [len("theirs")])
