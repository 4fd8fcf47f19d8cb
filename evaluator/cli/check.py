"""gsb-check: whether recordings are whole, and whether they follow the benchmark's protocol."""

from __future__ import annotations

import argparse
import sys

from gpusimbench.evaluator.cli.command import add_json, answer, check_target, entry_point, local_name, new_parser
from gpusimbench.schemas.commands.progress import each, sizes
from gpusimbench.schemas.errors import ExitCode, UsageError
from gpusimbench.schemas.location import place

_EPILOG = """\
exit codes:
  0  every rule holds; warnings do not count
  1  the results cannot be written
  2  wrong usage
  3  a file is damaged, cut short, no recording, or has lost data; the others were checked
  4  a rule is broken

rules:
  integrity-1 and recorders-1, the default, are for any recording: whether the file is whole, and whether its recorder
  had an error that was found later. --protocol adds the newest protocol, protocol-2, for runs of the benchmark: timed
  steps, evidence of work, clock rates, number of runs, one machine and one version a point. --rules takes a shipped set
  by its name, such as protocol-1 for older recordings, or a file.

see also:
  gsb-info, which shows one file
  gsb-audit, which also runs it again
  docs/check.md
  docs/strangers.md

examples:
  gsb-check recordings/*.mcap
  gsb-check --protocol submission/*.mcap --json findings.json
  gsb-check --rules integrity-1 --rules protocol-1 recordings/h200/*.mcap
  gsb-check --list-rules
"""


def parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    p = new_parser(
        "gsb-check",
        "Check recordings against rules: whether each file is whole, and whether the files agree with each other. The "
        "first line is the verdict; then each broken rule once, with the files that break it.",
        _EPILOG,
        reads=("TMPDIR",),
    )
    p.add_argument(
        "files", nargs="*", type=place, metavar="FILE", help="recordings (.mcap), folders of them, or addresses"
    )
    p.add_argument("--protocol", action="store_true", help="check the newest protocol of the benchmark as well")
    p.add_argument(
        "--rules",
        action="append",
        type=local_name,
        metavar="NAME|FILE",
        help="rule set instead of the default; repeatable",
    )
    p.add_argument("--all", action="store_true", help="list every finding of every file, by file")
    p.add_argument("--list-rules", action="store_true", help="show the rules, and what a file of rules can use")
    add_json(p, "findings")
    return p


def run(arguments: argparse.Namespace) -> int:
    """Check and print; returns the exit code."""
    from gpusimbench.evaluator.check.rules.findings import check
    from gpusimbench.evaluator.check.rules.rule import DEFAULT, PROTOCOL, SHIPPED, load_rules
    from gpusimbench.evaluator.report.check_document import check_document, dump_check, dump_rules, rules_document

    check_target(arguments.json)
    names = arguments.rules or (SHIPPED if arguments.list_rules else DEFAULT)
    names = list(dict.fromkeys([*names, *([PROTOCOL] if arguments.protocol else [])]))
    rule_sets = [load_rules(name) for name in names]
    if arguments.list_rules:
        answer(arguments.json, lambda: dump_rules(rule_sets), lambda: rules_document(rule_sets))
        return int(ExitCode.OK)
    if not arguments.files:
        raise UsageError("name the recordings to check, or --list-rules")
    from gpusimbench.evaluator.check.integrity import examine
    from gpusimbench.evaluator.read.addresses import expand

    files = expand(arguments.files)
    examined = [examine(path) for path in each(files, "checking recordings", sizes(files))]
    report = check(examined, rule_sets)
    answer(arguments.json, lambda: dump_check(report), lambda: check_document(report, every=arguments.all))
    return int(report.exit_code)


main = entry_point(parser, run)


if __name__ == "__main__":
    sys.exit(main())
