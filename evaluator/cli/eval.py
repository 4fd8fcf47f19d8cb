"""gsb-eval: every metric of a set of recordings, from the files alone."""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack
from typing import TYPE_CHECKING

from gpusimbench.evaluator.cli.command import (
    add_cache,
    add_json,
    add_sample_time,
    answer,
    check_sample_time,
    check_target,
    complain,
    entry_point,
    local_path,
    new_parser,
    store_of,
)
from gpusimbench.evaluator.render.formats import Format
from gpusimbench.schemas.commands.progress import stage
from gpusimbench.schemas.errors import ExitCode, NothingComparable, UsageError
from gpusimbench.schemas.location import Place, place
from gpusimbench.schemas.text import did_you_mean, line, plural, show
from gpusimbench.schemas.writing import write_files

if TYPE_CHECKING:
    from gpusimbench.evaluator.compute.mapping import Mapper
    from gpusimbench.evaluator.compute.work import Work
    from gpusimbench.evaluator.render.document import Document
    from gpusimbench.evaluator.results.evaluate import Evaluation
    from gpusimbench.evaluator.runs.run import Run


_EPILOG = """\
exit codes:
  0  every file was read and every recording is complete, failed or invalid by its own word
  1  the results cannot be written
  2  wrong usage
  3  the rest was evaluated, but a file is damaged, cut short or no recording, or a recording lost data
  5  no recording could be evaluated

files:
  CACHE/  what was read and computed, by content and version; it may be deleted at any time

see also:
  gsb-record, which makes recordings
  gsb-check, which holds them against rules
  docs/metrics.md
  docs/statistics.md

examples:
  gsb-eval recordings/*.mcap
  gsb-eval recordings/*.mcap --html report/ --published
  gsb-eval recordings/*.mcap --reference trials.mcap --json results.json
  gsb-eval recordings/*.mcap --tables tables/ --ray local
  gsb-eval recordings/*.mcap --figures figures/ --tables tables/ --format csv,md,tex
"""


def parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    p = new_parser(
        "gsb-eval",
        "Compute throughput, memory, variability and alignment from recordings. Files are grouped by what they hold: "
        "simulator, version, switches, scene, environments, step, device.",
        _EPILOG,
        reads=("GSB_CACHE", "OMP_NUM_THREADS"),
    )
    p.add_argument(
        "files", nargs="+", type=place, metavar="FILE", help="recordings (.mcap), folders of them, or addresses"
    )
    p.add_argument("--all", action="store_true", help="print every metric, remark and check of mechanics")
    p.add_argument("--reference", type=place, metavar="FILE", help="recording to compare positions with")
    add_sample_time(p)
    add_json(p, "results")
    p.add_argument("--html", type=local_path, metavar="DIR", help="write a report to DIR/index.html")
    p.add_argument("--tables", type=local_path, metavar="DIR", help="write metrics.parquet and runs.parquet")
    p.add_argument(
        "--format",
        type=_formats,
        default=(Format.PARQUET,),
        metavar="LIST",
        help=f"with --tables: any of {', '.join(Format)}, with commas between; all but parquet write the report's "
        "tables, a file each (default: parquet)",
    )
    p.add_argument("--figures", type=local_path, metavar="DIR", help="write each figure as SVG, PDF and CSV")
    p.add_argument("--published", action="store_true", help="show the paper's figures too, marked as such")
    p.add_argument("--no-verify", action="store_true", help="skip the digests; CRCs of what is read are still checked")
    p.add_argument("--ray", metavar="ADDRESS", help="spread the work over a Ray cluster: an address, auto, or local")
    add_cache(p)
    p.show_first(
        "--all", "--reference", "--sample-time", "--json", "--html", "--tables", "--format", "--figures", "--ray"
    )
    return p


def _formats(text: str) -> tuple[Format, ...]:
    """Formats of tables, each once."""
    known = [one.value for one in Format]
    names = dict.fromkeys(part.strip() for part in text.split(","))
    if unknown := [name for name in names if name not in known]:
        hint = did_you_mean(unknown[0], known)
        raise argparse.ArgumentTypeError(f"no format of tables: {', '.join(unknown)}; known: {', '.join(known)}{hint}")
    return tuple(map(Format, names))


def run(arguments: argparse.Namespace) -> int:
    """Evaluate and print; returns the exit code."""
    from gpusimbench.evaluator.inputs.reader import Reader
    from gpusimbench.evaluator.read.addresses import left_below
    from gpusimbench.evaluator.results.evaluate import read_and_evaluate

    check_sample_time(arguments.sample_time)
    check_target(arguments.json)
    if arguments.format != (Format.PARQUET,) and not arguments.tables:
        raise UsageError("--format says what --tables DIR writes; give both")
    if arguments.tables and Format.PARQUET in arguments.format:
        from gpusimbench.evaluator.report.parquet import polars

        polars()  # before anything is computed
    if arguments.figures:
        from gpusimbench.evaluator.report.paper import reportlab

        reportlab()
    with ExitStack() as stack:
        work = _work(arguments, stack)
        how = Reader(arguments.sample_time, verify=not arguments.no_verify)
        reference = _reference(arguments.reference)
        evaluation, recordings = read_and_evaluate(arguments.files, how, reference=reference, work=work)
    if work.store:
        work.store.prune()
    for failure in evaluation.unreadable:
        brief = evaluation.results and arguments.json != "-"  # what is printed then says what to do
        complain("gsb-eval", str(failure.error) if brief else failure.error.advised)
    for said in left_below(arguments.files):
        show(line(f"gsb-eval: {said}"), error=True)
    if not evaluation.results:
        if len(evaluation.unreadable) == 1:
            return int(evaluation.unreadable[0].error.exit_code)
        what = "only real trials" if recordings else "no recording that can be read"
        raise NothingComparable(f"nothing to evaluate: there is {what} among the files")
    _present(evaluation, arguments)
    return _exit_code(evaluation, recordings)


def _work(arguments: argparse.Namespace, stack: ExitStack) -> Work:
    from gpusimbench.evaluator.compute.mapping import serial
    from gpusimbench.evaluator.compute.work import Work

    mapper: Mapper = serial
    if arguments.ray:
        from gpusimbench.evaluator.compute.cluster import Cluster

        mapper = stack.enter_context(Cluster(arguments.ray))
    return Work(mapper, store_of(arguments))


def _reference(given: Place | None) -> Place | None:
    from gpusimbench.evaluator.read.addresses import expand

    found = expand([given]) if given else []
    if len(found) > 1:
        raise UsageError(f"--reference is one recording; {given} stands for {len(found)}")
    return found[0] if found else None


def _present(evaluation: Evaluation, arguments: argparse.Namespace) -> None:
    from gpusimbench.evaluator.report.json import dump_json

    answer(arguments.json, lambda: dump_json(evaluation), lambda: _document(evaluation, arguments))
    if arguments.tables:
        from gpusimbench.evaluator.render.table_files import table_files
        from gpusimbench.evaluator.report.document import in_short
        from gpusimbench.evaluator.report.parquet import parquet_tables
        from gpusimbench.evaluator.report.source import Source

        tables = parquet_tables(evaluation) if Format.PARQUET in arguments.format else {}
        document = in_short(Source(evaluation, arguments.published, arguments.command_line))
        tables |= table_files(document, arguments.format)
        paths = {arguments.tables / name: content for name, content in tables.items()}
        write_files(paths)
        show(line(f"tables: {plural(len(paths), 'file')} in {arguments.tables}"), error=arguments.json == "-")
    if arguments.figures:
        from gpusimbench.evaluator.report.paper import write_figures

        with stage("drawing figures"):
            written = write_figures(evaluation, arguments.figures, published=arguments.published)
        count = sum(path.suffix == ".pdf" for path in written)
        said = f"figures: {count} in {arguments.figures}, listed in {written[-1]}"
        show(line(said), error=arguments.json == "-")
    if arguments.html:
        from gpusimbench.evaluator.report.document import write_html

        with stage("writing the report"):
            page = write_html(evaluation, arguments.html, published=arguments.published, command=arguments.command_line)
        show(line(f"report: {page}"), error=arguments.json == "-")


def _document(evaluation: Evaluation, arguments: argparse.Namespace) -> Document:
    if arguments.all:
        from gpusimbench.evaluator.report.document import in_short
        from gpusimbench.evaluator.report.source import Source

        return in_short(Source(evaluation, arguments.published, arguments.command_line))
    from gpusimbench.evaluator.report.brief import brief

    return brief(evaluation)


def _exit_code(evaluation: Evaluation, recordings: list[Run]) -> int:
    lost = any(r.status == "incomplete" or r.dropouts for r in recordings)
    if evaluation.unreadable or lost:
        return int(ExitCode.DATA_LOST)
    if not any(r.status == "complete" for r in recordings):
        return int(ExitCode.NOTHING_COMPARABLE)
    return int(ExitCode.OK)


main = entry_point(parser, run)


if __name__ == "__main__":
    sys.exit(main())
