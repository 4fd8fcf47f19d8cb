"""gsb-import: what engines made of a model file, compared with MuJoCo C: parameters, kinematics, responses."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from gpusimbench.evaluator.cli.command import add_json, answer, check_target, entry_point, new_parser
from gpusimbench.schemas.commands.parser import Parser
from gpusimbench.schemas.errors import ExitCode, UsageError
from gpusimbench.schemas.location import place

if TYPE_CHECKING:
    from gpusimbench.evaluator.imports.audit import Audit

_OUT = Path("imports")

_EPILOG = """\
Every engine reads a model file by an importer of its own, and what an importer does not know is often dropped without
a message. gsb-import records, for MuJoCo C and for each engine, the parameters that the engine holds (masses, inertias,
joints, gains, limits, friction, equalities, ...), where its kinematics place the bodies in 16 drawn poses, and how each
joint moves that begins with a speed, and each actuator that is given a control, within 10 steps. It compares them by
name and says what differs, by how much, and what is missing. A model with a free body is also dropped, from its first
state and without controls: a table has the time of its first contact with the ground and the share of its weight that
is carried 0.5 s later, for MuJoCo C and for the engine. The drop is not judged.

Tolerances: numbers may differ by what single precision rounds, bodies by 1e-05 m and 0.0001 rad, velocities of a
response by 0.1 of what the reference changes in a time step. Trials in which bodies touch are not compared.

The recordings lie in --out. With recordings or folders instead of --sim nothing is recorded: each recording of a model
is compared with that of MuJoCo C among them. Every recording of a model file has the parameters; one that was made with
--phases import has poses and responses, too.

exit codes:
  0  all engines agree with MuJoCo C
  1  a run could not be recorded
  2  wrong usage
  3  a recording is damaged
  4  an engine differs, or refuses the model
  5  nothing can be compared

files:
  OUT/NAME.mcap  a run, a recording like any other

see also:
  gsb-record --model, which makes its runs
  gsb-probe
  docs/how-to/my-robot.md
  docs/how-to/what-the-importer-lost.md

examples:
  gsb-import robot.xml --sim warp,mjx
  gsb-import robot.xml --sim warp --option solver=Newton --json -
  gsb-import imports --all
"""


def parser() -> Parser:
    """The command's arguments."""
    p = new_parser(
        "gsb-import",
        "Compare what engines made of a model file with what MuJoCo C made of it: parameters, kinematics, responses.",
        _EPILOG,
        reads=(
            "CUDA_VISIBLE_DEVICES",
            "GSB_ENVIRONMENTS",
        ),
    )
    p.add_argument(
        "files", nargs="+", type=place, metavar="FILE",
        help="with --sim: a model file, MJCF or URDF; else recordings of a model, or folders of them",
    )  # fmt: skip
    p.add_argument("--sim", metavar="NAME[,NAME]", help="engines that are to read the model; see gsb-record --list")
    p.add_argument(
        "--option", action="append", default=[], metavar="NAME=VALUE",
        help="of these engines, not of MuJoCo C, which compiles the model as it is; repeatable",
    )  # fmt: skip
    p.add_argument("--seed", type=int, default=0, metavar="N", help="of the drawn poses (default: %(default)s)")
    p.add_argument("--out", type=Path, default=_OUT, metavar="DIR", help="of the recordings (default: %(default)s/)")
    p.add_argument("--all", action="store_true", help="show every difference, and what was not compared")
    add_json(p, "result")
    return p


def run(arguments: argparse.Namespace) -> int:
    """Record if asked to, compare and print; returns the exit code."""
    from gpusimbench.evaluator.imports.audit import audited
    from gpusimbench.evaluator.imports.sections import dump_import, import_document
    from gpusimbench.evaluator.read.addresses import expand
    from gpusimbench.evaluator.runs.validation import verified

    check_target(arguments.json)
    if arguments.sim:
        audits = _recorded(arguments)
    else:
        _check_recordings(arguments)
        audits = audited(verified(list(expand(arguments.files))))
    answer(arguments.json, lambda: dump_import(audits), lambda: import_document(audits, every=arguments.all))
    return int(ExitCode.OK if all(audit.agrees for audit in audits) else ExitCode.GATE_FAILED)


def _check_recordings(arguments: argparse.Namespace) -> None:
    if models := [path for path in arguments.files if str(path).lower().endswith((".xml", ".urdf", ".mjcf"))]:
        raise UsageError(f"{models[0]} is a model file: name the engines that are to read it, such as --sim warp,mjx")
    if arguments.option:
        raise UsageError("--option is of engines that --sim names; recordings were made with theirs")


def _recorded(arguments: argparse.Namespace) -> tuple[Audit, ...]:
    from gpusimbench.evaluator.imports.audit import REFERENCE, ModelRuns

    names = list(dict.fromkeys(filter(None, (part.strip() for part in arguments.sim.split(",")))))
    engines = [name for name in names if name != REFERENCE]
    if len(arguments.files) > 1 or not isinstance(arguments.files[0], Path):
        raise UsageError("--sim takes one model file of this machine")
    if not engines:
        raise UsageError(f"--sim names engines to be compared with MuJoCo C, such as warp,mjx, not '{arguments.sim}'")
    return ModelRuns(arguments.files[0], arguments.seed, arguments.out).audited(engines, arguments.option)


main = entry_point(parser, run)


if __name__ == "__main__":
    sys.exit(main())
