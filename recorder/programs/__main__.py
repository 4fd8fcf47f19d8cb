"""Runs of a program, one after another: ``python -m gpusimbench.recorder.programs RUNS OUT TIME_LIMIT PROGRAM...``.

gsb-run and gsb-audit --command start it. Standard output gets one JSON object, standard error a line at each begin and
each end.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path

from gpusimbench.recorder.probes.gpu import Gpus
from gpusimbench.recorder.process.launch import Interruptions
from gpusimbench.recorder.programs.run import OUTPUT, ProgramRun, adopt, end_with_parent, new_folder, run_program
from gpusimbench.schemas.errors import ExitCode, GsbError
from gpusimbench.schemas.text import line, show, show_document


def main() -> int:
    """Run the program; returns the exit code."""
    runs, out, time_limit, *command = sys.argv[1:]
    made: list[ProgramRun] = []
    adopt()
    end_with_parent()  # gsb-run may be killed; nobody would wait for the program then
    try:
        with Interruptions() as interruptions, Gpus() as gpus:
            for _ in range(int(runs)):
                folder = new_folder(Path(out))
                show(line(f"{folder}: begun; what the program prints goes to {folder / OUTPUT}"), error=True)
                made.append(
                    run_program(
                        command, folder, time_limit=float(time_limit), gpus=gpus, interruptions=interruptions
                    )
                )  # fmt: skip
                show(line(f"{folder}: {made[-1].reason or f'ended after {made[-1].seconds:.1f} s'}"), error=True)
                if interruptions.count:
                    break
    except GsbError as error:
        show(line(f"gsb-run: {error}"), error=True)
        return int(error.exit_code)
    show_document(json.dumps({"runs": [asdict(run) for run in made]}) + "\n")
    return int(ExitCode.OK)


if __name__ == "__main__":
    sys.exit(main())
