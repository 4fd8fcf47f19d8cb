"""The reference pages of the site, made of the code that they describe when the site is built; none is kept.

python docs/make_reference.py FOLDER
"""

from __future__ import annotations

import argparse
import ast
import inspect
import re
import sys
import textwrap
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import FunctionType, ModuleType

from gpusimbench.schemas import errors
from gpusimbench.schemas.errors import ExitCode, UsageError

ROOT = Path(__file__).resolve().parent.parent
FORMULAS = (
    "gpusimbench.evaluator.metrics",
    "gpusimbench.evaluator.metrics.physics",
    "gpusimbench.evaluator.statistics",
    "gpusimbench.evaluator.transport",
)
"""Packages of pure functions, whose docstrings have the formulas."""


def pages() -> dict[str, str]:
    """Text of every page by its name, with links as from a page in docs/reference."""
    found = {name: command_page(name, parser) for name, parser in parsers().items()}
    return {
        "index": _INDEX,
        **found,
        "exit-codes": exit_codes(),
        "metrics": metrics(),
        "formulas": formulas(),
        "messages": messages(),
        "rules": rules(),
        "options": options(),
        "scenes": scenes(),
    }


_INDEX = """\
# Reference

Made from the code when this site is built, so that it says what the commands do.

* **Commands**, one page each with every option, and [their exit codes](exit-codes.md).
* **Metrics**: [definitions](../metrics.md), [units and directions](metrics.md), [formulas](formulas.md) as they stand
  in the code.
* **Format**: [what is in a file](../../schemas/README.md), [the messages](messages.md), and [the rules](rules.md) that
  `gsb-check` asks.
* **Simulators**: [how each is stepped and what was run](../simulators.md), [their options](options.md), and [the
  scenes](scenes.md).
"""


def entry_points() -> dict[str, str]:
    """The module whose main each installed command is, by the command's name."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return {name: target.partition(":")[0] for name, target in project["scripts"].items()}


def parsers() -> dict[str, argparse.ArgumentParser]:
    """The parser of every command that the package installs, by the command's name."""
    return {name: module.parser() for name, module in modules().items()}


def modules() -> dict[str, ModuleType]:
    """The module with the parser and the work of every command; that of gsb-record's main imports next to nothing."""
    elsewhere = {"gpusimbench.recorder.cli": "gpusimbench.recorder.command.arguments"}
    return {name: import_module(elsewhere.get(module, module)) for name, module in entry_points().items()}


def sections(epilog: str) -> dict[str, str]:
    """Paragraphs of a help text's end by their heading, a line that ends with a colon, without the indentation."""
    parts = re.split(r"^(\S[^\n]*):\n", epilog, flags=re.MULTILINE)
    return {"": parts[0]} | {title: textwrap.dedent(text) for title, text in zip(parts[1::2], parts[2::2], strict=True)}


def codes(epilog: str) -> dict[int, str]:
    """What a command's help says of each exit code."""
    lines = re.split(r"^(\d)  ", sections(epilog)["exit codes"], flags=re.MULTILINE)
    return {int(code): " ".join(text.split()) for code, text in zip(lines[1::2], lines[2::2], strict=True)}


def command_page(name: str, parser: argparse.ArgumentParser) -> str:
    """A command's description, usage, options and the end of its help."""
    text = [f"# {name}", str(parser.description), _fenced(usage(parser)), *_options(parser)]
    for verb, below in verbs(parser).items():
        text += [f"## {name} {verb}", str(below.description), _fenced(usage(below)), *_options(below, level=3)]
    for title, body in sections(parser.epilog or "").items():
        if title == "exit codes":
            text += [
                "## Exit codes",
                _table(("code", "when"), [(str(c), t) for c, t in codes(parser.epilog or "").items()]),
            ]
        elif title:
            text += [f"## {title.capitalize()}", _fenced(body) if _is_set(body) else _escape(body)]
        elif body.strip():
            text.append(_escape(body))
    return "\n\n".join(part.strip("\n") for part in text) + "\n"


def verbs(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The parsers of a command's verbs, where it has some."""
    return {
        verb: below
        for action in parser._actions
        if isinstance(action, argparse._SubParsersAction)
        for verb, below in action.choices.items()
    }


def exit_codes() -> str:
    """Which error ends with which code, and what the commands say of each."""
    tree = str(errors.__doc__).partition("\n\n")[2]
    by_command = {name: codes(parser.epilog or "") for name, parser in parsers().items()}
    text = ["# Exit codes", "All commands share them.", _fenced(tree)]
    for code in ExitCode:
        rows = [(f"[`{name}`]({name}.md)", said[code]) for name, said in by_command.items() if code in said]
        text += [f"## {code.value}: {code.name.lower().replace('_', ' ')}", _table(("command", "when"), rows)]
    return "\n\n".join(text) + "\n"


def metrics() -> str:
    """Every metric of an evaluation, with unit and direction, from the declarations."""
    from gpusimbench.evaluator.results.metrics import METRICS

    better = {"higher": "higher", "lower": "lower", "neither": "-"}
    rows = [
        (
            f"`{m.name}`",
            m.unit or "-",
            better[m.direction.value],
            f"{'*published*: ' if m.published else ''}{m.docs}".replace("](#", "](metrics.md#").replace("](", "](../"),
        )
        for m in METRICS.values()
    ]
    text = "What `gsb-eval --json` has under `metrics` of each group. [Metrics](../metrics.md) says how to read them."
    return f"# Units and directions\n\n{text}\n\n{_table(('name', 'unit', 'better', 'what'), rows)}\n"


def formulas() -> str:
    """The docstrings of what computes: formula, arguments with shapes and units, errors."""
    text = ["# Formulas", "Docstrings of the functions on arrays that every value comes from."]
    for package in FORMULAS:
        text.append(f"## {package}")
        for name, module in _modules(package):
            path = Path(str(module.__file__)).relative_to(ROOT)
            text += [f"### {name}", f"{module.__doc__}\n\n[`{path}`](../../{path})"]
            for function in _functions(module):
                text.append(_fenced(_signature(function) + _indented(function.__doc__ or ""), "python"))
    return "\n\n".join(text) + "\n"


def messages() -> str:
    """The message types, as their source has them."""
    text = [
        "# Messages",
        "Every recording carries these definitions, so nothing here is needed to read one: see "
        "[how](../how-to/read-without-our-code.md). What the topics are is in [the format](../../schemas/README.md).",
    ]
    for path in sorted((ROOT / "schemas" / "proto" / "gsb" / "v1").glob("*.proto")):
        body = path.read_text(encoding="utf-8").partition("package gsb.v1;\n")[2]
        text += [f"## {path.name}", _fenced(body.strip("\n"), "proto")]
    return "\n\n".join(text) + "\n"


def rules() -> str:
    """Every rule of the sets that ship with gsb-check."""
    from gpusimbench.evaluator.check.rules.rule import SHIPPED, load_rules

    text = [
        "# Rules of gsb-check",
        "[What is in a recording](../check.md) says how to use them, and how to write others.",
    ]
    for rule_set in map(load_rules, SHIPPED):
        text += [f"## {rule_set.name}", f"{rule_set.title[0].upper()}{rule_set.title[1:]}."]
        rows = [(f"`{r.id}`", r.level.value, r.requires, r.why, r.do) for r in rule_set.rules]
        text.append(_table(("rule", "level", "requires", "why", "what to do"), rows))
    return "\n\n".join(text) + "\n"


def options() -> str:
    """Every simulator with its options, their defaults, and its levels of determinism."""
    from gpusimbench.recorder.abilities import Ability, titles
    from gpusimbench.recorder.simulators.registry import BUILT_IN

    text = [
        "# Options of simulators",
        "`--option NAME=VALUE`, and what `--determinism` takes. What the options mean to each engine, and which were "
        "run where, is in [simulators](../simulators.md).",
        "A simulator takes every scene that needs no more than its abilities:",
        _table(("ability", "meaning"), [(ability.title, ability.meaning) for ability in Ability]),
    ]
    for entry in BUILT_IN:
        text += [f"## {entry.name}", f"{entry.summary}. Devices: {_words(entry.devices)}. States: "
                 f"{_words(entry.precision)}."]  # fmt: skip
        try:
            adapter = entry.adapter()
        except UsageError as error:
            text.append(f"Its options cannot be shown: {error}")
            continue
        text.append(f"Abilities: {_words(titles(adapter.abilities))}.")
        rows = [(f"`{f.name}`", f.type if isinstance(f.type, str) else f.type.__name__, f"`{f.default!r}`")
                for f in fields(adapter.Options)]  # fmt: skip
        text.append(_table(("option", "type", "default"), rows) if rows else "It has no options.")
        said = [kind.__doc__ for kind in reversed(adapter.Options.__mro__) if kind is not object and kind.__doc__]
        text += [_fenced(inspect.cleandoc(doc)) for doc in said if not doc.startswith(f"{adapter.Options.__name__}(")]
        text.append(_table(("level", "what it sets"), [(f"`{k}`", v) for k, v in adapter.determinism_levels.items()]))
    return "\n\n".join(text) + "\n"


def scenes() -> str:
    """Every scene that ships, with its bodies and materials."""
    from gpusimbench.recorder.abilities import titles
    from gpusimbench.recorder.scenes.registry import SCENES, make_scene

    text = ["# Scenes", "SI units, world frame, z up. Every recording has its scene whole, in `scene.json`."]
    for name in SCENES:
        scene = make_scene(name)
        doc = inspect.getdoc(import_module(f"gpusimbench.recorder.scenes.{name.replace('-', '_')}")) or ""
        text += [f"## {name}", doc, f"dt {scene.dt} s; positions are compared at {scene.sample_time} s."]
        made = {m.name: m for m in (body.material for body in scene.bodies)}
        rows = [(m.name, *map(str, (m.static_friction, m.kinetic_friction, m.restitution))) for m in made.values()]
        if rows:
            text.append(_table(("material", "static friction", "kinetic friction", "restitution"), rows))
        text.append(f"It needs: {_words(titles(scene.needs()))}.")
        groups = {group: len(names) for group, names in scene.groups().items()}
        text.append(f"Groups of the state: {_words([f'{group} ({n})' for group, n in groups.items()])}.")
    return "\n\n".join(text) + "\n"


def usage(parser: argparse.ArgumentParser) -> str:
    """How a command is called."""
    formatter = argparse.HelpFormatter(parser.prog, width=100)
    formatter.add_usage(parser.usage, parser._actions, parser._mutually_exclusive_groups, prefix="")
    return formatter.format_help().strip().replace("\n       ", "\n")


def options_of(parser: argparse.ArgumentParser) -> Iterator[tuple[str, list[tuple[list[str], str]]]]:
    """Titles of a parser's groups, and of each option how it is written, and what it does."""
    for group in parser._action_groups:
        shown = [action for action in group._group_actions if action.help != argparse.SUPPRESS]
        shown = [action for action in shown if not isinstance(action, argparse._SubParsersAction)]
        if shown:
            yield str(group.title), [_option(action, parser) for action in shown]


def _option(action: argparse.Action, parser: argparse.ArgumentParser) -> tuple[list[str], str]:
    closed = "{" + ",".join(map(str, action.choices)) + "}" if action.choices else action.dest.upper()
    takes = "" if action.nargs == 0 else action.metavar or closed
    names = [f"{name} {takes}".strip() for name in action.option_strings] or [str(takes)]
    return names, (action.help or "") % {**vars(action), "prog": parser.prog}


def _options(parser: argparse.ArgumentParser, level: int = 2) -> Iterator[str]:
    for title, options in options_of(parser):
        rows = [(", ".join(f"`{name}`" for name in names), _escape(meaning)) for names, meaning in options]
        yield f"{'#' * level} {title.capitalize()}"
        yield _table(("option", "what"), rows)


def _modules(package: str) -> Iterator[tuple[str, ModuleType]]:
    folder = import_module(package)
    for found in iter_modules(folder.__path__):
        if not found.ispkg:
            yield found.name, import_module(f"{package}.{found.name}")


def _functions(module: ModuleType) -> Iterator[FunctionType]:
    for name, member in vars(module).items():
        ours = getattr(member, "__module__", None) == module.__name__
        if inspect.isfunction(member) and ours and not name.startswith("_"):
            yield member


def _is_set(body: str) -> bool:
    # commands, and columns that a paragraph would run together
    return "  " in body.strip() or body.startswith("gsb-")


def _words(names: object) -> str:
    return ", ".join(map(str, names)) or "-"  # type: ignore[call-overload]


def _fenced(text: str, language: str = "text") -> str:
    return f"```{language}\n{text.strip()}\n```"


def _signature(function: FunctionType) -> str:
    (node,) = ast.parse(inspect.getsource(function)).body
    assert isinstance(node, ast.FunctionDef)
    returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    return f"def {node.name}({ast.unparse(node.args)}){returns}:\n"


def _indented(text: str) -> str:
    clean = inspect.cleandoc(text)
    end = "\n" if "\n" in clean else ""
    return textwrap.indent(f'"""{clean}{end}"""', "    ")


def _escape(text: str) -> str:
    return re.sub(r"([*_<\[\]])", r"\\\1", text)


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    cells = [[cell.replace("|", "\\|").replace("\n", " ") for cell in row] for row in rows]
    return "\n".join("| " + " | ".join(row) + " |" for row in [list(head), ["---"] * len(head), *cells])


def main() -> None:
    """Write the pages into a folder."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in pages().items():
        (folder / f"{name}.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
