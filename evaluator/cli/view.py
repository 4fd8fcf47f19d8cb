"""gsb-view: recordings in motion, in a page of their own or in a viewer that is installed."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from gpusimbench.evaluator.cli.command import complain, entry_point, local_path, new_parser
from gpusimbench.schemas.commands.progress import stage
from gpusimbench.schemas.errors import ExitCode, UsageError
from gpusimbench.schemas.location import place
from gpusimbench.schemas.text import line, show
from gpusimbench.schemas.writing import write_file

if TYPE_CHECKING:
    from gpusimbench.evaluator.player.clip import Clip
    from gpusimbench.evaluator.player.programs import Program
    from gpusimbench.evaluator.read.recording import Recording

_PROGRAMS = ("auto", "page", "rerun", "foxglove", "lichtblick")

_EPILOG = """\
The page is one file and needs no network. It shows environments in 3D over simulated time; environments that are
bit-identical so far have one colour, and a button jumps to the first divergence. Several files of one scene are drawn
together. A task's recording without places of bodies is shown as curves of rewards, actions and observations.

exit codes:
  0  the recordings are shown, or, without a display, the command says where the page is
  1  the page cannot be written, or the program cannot be started
  2  wrong usage
  3  a file is damaged or not a recording; or a recording is cut short or lost data, and what is there is shown
  5  a file holds no states, so there is nothing to show

see also:
  gsb-diff, which says in numbers where two recordings first differ
  gsb-share viewer
  docs/view.md
  docs/viewers.md

examples:
  gsb-view recordings/h200/physx-spacing-0-inclined-collision-n16-r0.mcap
  gsb-view recordings/mujoco-xeon-r0.mcap recordings/mujoco-pyramidal-r0.mcap --out view.html --no-open
  gsb-view recordings/mujoco-amd-r0.mcap --with rerun --env 0 --env 3
"""


def parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    p = new_parser(
        "gsb-view", "Show environments of recordings in motion, and the step at which the first bits differ.", _EPILOG
    )
    p.add_argument(
        "files", nargs="+", type=place, metavar="FILE", help="recordings (.mcap), folders of them, or addresses"
    )
    p.add_argument(
        "--with", dest="program", choices=_PROGRAMS, default="auto",
        help="what to open (default: auto: Foxglove or Lichtblick if installed, else the page)",
    )  # fmt: skip
    p.add_argument(
        "--env", type=int, action="append", default=[], metavar="E",
        help="environment to show, of each file; repeatable (default: one of each bitwise class, up to six)",
    )  # fmt: skip
    p.add_argument("--out", type=local_path, metavar="FILE.html", help="keep the page (default: in a temporary folder)")
    p.add_argument("--no-open", action="store_true", help="write the page without opening it, and say where it is")
    p.add_argument(
        "--spread", type=float, default=0.5, metavar="M",
        help="for other programs: distance between environments that are at one place [m] (default: 0.5)",
    )  # fmt: skip
    return p


def run(arguments: argparse.Namespace) -> int:
    """Read, write and open; returns the exit code."""
    from gpusimbench.evaluator.player.clip import make_clip
    from gpusimbench.evaluator.player.page import sentences
    from gpusimbench.evaluator.player.programs import Program, found
    from gpusimbench.evaluator.read.addresses import expand
    from gpusimbench.evaluator.read.recording import Recording

    out: Path | None = arguments.out
    if out is not None and out.suffix not in (".html", ".htm"):
        raise UsageError(f"--out names the page; call it .html instead of {out.name}")
    if out is not None and arguments.program not in ("auto", "page"):
        raise UsageError(f"--out keeps the page; with --with {arguments.program} there is none")
    program = Program.PAGE if out is not None else found(arguments.program)
    recordings = [Recording(path) for path in expand(arguments.files)]
    if arguments.program in ("auto", "page"):
        from gpusimbench.evaluator.player.page import only_curves

        if only_curves(recordings):
            _curves(recordings, arguments.env, out, arguments.command_line, opened=not arguments.no_open)
            return _ended(recordings)
    with stage("reading states"):
        clip = make_clip(recordings, envs=arguments.env)
    for sentence in sentences(clip):
        complain("gsb-view", sentence)
    if program is Program.PAGE:
        _page(clip, recordings, out, arguments.command_line, opened=not arguments.no_open)
    else:
        _elsewhere(program, clip, recordings, arguments.spread, started=not arguments.no_open)
    return _ended(recordings)


def _ended(recordings: list[Recording]) -> int:
    lost = [r for r in recordings if r.status == "incomplete" or r.dropouts]
    return int(ExitCode.DATA_LOST if lost else ExitCode.OK)


def _curves(recordings: list[Recording], envs: list[int], out: Path | None, command: str, *, opened: bool) -> None:
    from gpusimbench.evaluator.player.page import task_document
    from gpusimbench.evaluator.render.html import render_page

    with stage("reading states"):
        text = render_page(task_document(recordings, envs, command))
    complain("gsb-view", "No place of a body was recorded: the page shows rewards, actions and observations as curves.")
    _keep(text, recordings, out, opened=opened)


def _page(clip: Clip, recordings: list[Recording], out: Path | None, command: str, *, opened: bool) -> None:
    from gpusimbench.evaluator.player.page import render_page

    _keep(render_page(clip, recordings, command=command), recordings, out, opened=opened)


def _keep(text: str, recordings: list[Recording], out: Path | None, *, opened: bool) -> None:
    from gpusimbench.evaluator.player.programs import open_page

    with _folder() if out is None else nullcontext(out.parent) as folder:
        path = out or folder / f"{Path(recordings[0].path.name).stem}.html"
        write_file(path, text)
    _say(path)
    if opened and not open_page(path):
        complain("gsb-view", f"no browser can be opened from here; the page is {path}, open it in one")


def _elsewhere(program: Program, clip: Clip, recordings: list[Recording], spread: float, *, started: bool) -> None:
    from gpusimbench.evaluator.player.programs import start
    from gpusimbench.evaluator.player.viewer import views

    with _folder() as folder:
        files = views(recordings, clip, folder, spread=spread)
    for recording, file in zip(recordings, files, strict=True):
        if file != recording.path:
            complain("gsb-view", f"{recording.path} lacks some of these for {program.value}; a view was written")
        _say(file)
    if started:
        start(program, files)


@contextmanager
def _folder() -> Iterator[Path]:
    """A new folder that stays, since what opens its files reads them later; an empty one does not stay."""
    import tempfile

    from gpusimbench.schemas.scratch import making

    with making():
        folder = Path(tempfile.mkdtemp(prefix="gsb-view-"))
    try:
        yield folder
    finally:
        with suppress(OSError):  # files are in it
            folder.rmdir()


def _say(path: Path) -> None:
    show(line(str(path)))


main = entry_point(parser, run)


if __name__ == "__main__":
    sys.exit(main())
