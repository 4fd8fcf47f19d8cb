"""gsb-record: run a scene in N environments on a simulator and write one recording per run.

This module imports next to nothing, so that an interruption during the imports is caught here.
"""

from __future__ import annotations

import sys


def main(argv: list[str] | None = None) -> int:
    """Entry point of gsb-record."""
    try:
        from gpusimbench.recorder import interruption

        interruption.install()
        with interruption.shielded():
            from gpusimbench.recorder.command.command import run
            from gpusimbench.schemas.commands.output import let_readers_leave
            from gpusimbench.schemas.errors import GsbError
            from gpusimbench.schemas.text import line, show
        let_readers_leave()
        try:
            return run(sys.argv[1:] if argv is None else argv)
        except GsbError as error:
            show(line(f"gsb-record: {error}"), error=True)
            return int(error.exit_code)
    except KeyboardInterrupt:
        sys.stderr.write("gsb-record: interrupted\n")
        return 1


if __name__ == "__main__":
    sys.exit(main())
