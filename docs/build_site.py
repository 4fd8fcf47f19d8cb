"""The documents as a site: gathered, with reference pages made of the code, and built so that a dead link fails.

    python docs/build_site.py site

docs/ is the root of the site. Documents that lie elsewhere in the repository get a place in it (PLACES), and files of
code that any of them links to are shown as pages, so that every link of the repository leads somewhere on the site too.
"""

from __future__ import annotations

import argparse
import logging
import os
import posixpath
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
import make_reference  # noqa: E402 - a script beside this one

ROOT = Path(__file__).resolve().parent.parent
CONFIGURATION = ROOT / "docs" / "mkdocs.yml"

PLACES = {
    "README.md": "project/readme.md",
    "CONTRIBUTING.md": "project/contributing.md",
    "CHANGELOG.md": "project/changelog.md",
    "benchmarks/README.md": "project/benchmarks.md",
    "recordings/README.md": "project/recordings.md",
    "recordings/h200/README.md": "project/recordings-h200.md",
    "recordings/replays/README.md": "project/recordings-replays.md",
    "schemas/README.md": "reference/format.md",
    "examples/ballistic-simulator/README.md": "examples/ballistic-simulator.md",
    "examples/log_your_own/README.md": "examples/log_your_own.md",
}
"""Documents outside of docs/ by their path in the repository, and their place on the site."""

_LANGUAGES = {".py": "python", ".proto": "proto", ".toml": "toml", ".md": "markdown", ".cff": "yaml"}

_CODE_OR_LINK = re.compile(r"^```.*?^```|`[^`\n]+`|\]\((?P<target>[^)\s]+)\)", re.DOTALL | re.MULTILINE)

_LARGEST = 200_000  # a file of code that is linked to and larger is no page for reading


def gather(folder: Path) -> None:
    """Write the source of every page into a folder; ValueError for a link that leads nowhere."""
    texts = {f"docs/reference/{name}.md": text for name, text in make_reference.pages().items()}
    for path in (*(ROOT / "docs").rglob("*.md"), *(ROOT / name for name in PLACES)):
        texts[str(path.relative_to(ROOT))] = path.read_text(encoding="utf-8")
    code: set[str] = set()
    for name, text in sorted(texts.items()):
        _write(folder / _place(name), with_links(text, partial(_resolve, page=name, texts=texts, code=code)))
    for name in sorted(code | {inside for folder in code for inside in _inside(folder)}):
        _write(folder / _source_place(name), _source_page(name))
    for path in (*(ROOT / "docs" / "site").iterdir(), *(ROOT / "docs" / "figures").iterdir()):
        _write(folder / path.relative_to(ROOT / "docs"), path.read_text(encoding="utf-8"))


def with_links(text: str, resolve: Callable[[str], str]) -> str:
    """A Markdown text with the target of every link replaced; what is code stays as it is."""
    return _CODE_OR_LINK.sub(lambda m: f"]({resolve(m['target'])})" if m["target"] else m[0], text)


def build(folder: Path) -> int:
    """Build the site into a folder; returns how many warnings there were, and a dead link is one."""
    os.environ["NO_MKDOCS_2_WARNING"] = "1"
    from mkdocs.commands.build import build as make
    from mkdocs.config import load_config

    counter = _Counter(logging.WARNING)
    logger = logging.getLogger("mkdocs")
    logger.addHandler(counter)
    try:
        with tempfile.TemporaryDirectory() as temporary:
            gather(Path(temporary))
            make(load_config(str(CONFIGURATION), docs_dir=temporary, site_dir=str(folder.resolve())))
    finally:
        logger.removeHandler(counter)
    return counter.count


class _Counter(logging.Handler):
    count = 0

    def emit(self, record: logging.LogRecord) -> None:
        self.count += 1
        print(record.getMessage(), file=sys.stderr)


def _resolve(link: str, page: str, texts: dict[str, str], code: set[str]) -> str:
    target, hash_, anchor = link.partition("#")
    if not target or target.startswith(("http:", "https:", "mailto:")):
        return link
    path = posixpath.normpath(posixpath.join(posixpath.dirname(page), target))
    if path in texts:
        place = _place(path)
    elif path.startswith("docs/figures/"):
        place = path.removeprefix("docs/")
    elif not path.startswith("..") and (ROOT / path).exists():
        readme = f"{path}/README.md"
        place = _place(readme) if readme in texts else _source_place(path)
        if readme not in texts:
            code.add(path)
    else:
        raise ValueError(f"{page} links to {target}, which is not there")
    return posixpath.relpath(place, posixpath.dirname(_place(page)) or ".") + hash_ + anchor


def _place(name: str) -> str:
    return PLACES.get(name) or name.removeprefix("docs/")


def _source_place(name: str) -> str:
    return f"source/{name}/index.md" if (ROOT / name).is_dir() else f"source/{name}.md"


def _inside(name: str) -> Iterator[str]:
    folder = ROOT / name
    if folder.is_dir():
        yield from (str(path.relative_to(ROOT)) for path in sorted(folder.iterdir()) if _is_code(path))


def _is_code(path: Path) -> bool:
    return path.is_file() and path.suffix in _LANGUAGES and path.stat().st_size <= _LARGEST


def _source_page(name: str) -> str:
    path = ROOT / name
    if path.is_dir():
        lines = [f"* [`{posixpath.basename(inside)}`]({posixpath.basename(inside)}.md){_summary(inside)}"
                 for inside in _inside(name)]  # fmt: skip
        return f"# {name}/\n\n" + "\n".join(lines) + "\n"
    if not _is_code(path):
        return f"# {name}\n\nThis file is in the repository; it is not shown here.\n"
    text = path.read_text(encoding="utf-8")
    fence = "`" * (max([3, *(len(run) + 1 for run in re.findall(r"`{3,}", text))]))
    head = "---\nsearch:\n  exclude: true\n---\n"
    return f"{head}# {name}\n\n{fence}{_LANGUAGES[path.suffix]}\n{text.rstrip()}\n{fence}\n"


def _summary(name: str) -> str:
    first = re.match(r'"""(.+?)("""|$)', (ROOT / name).read_text(encoding="utf-8"), re.MULTILINE)
    return f": {first[1].strip()}" if first else ""


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def main() -> int:
    """Build into the folder that is named; 1 where anything was warned of."""
    parser = argparse.ArgumentParser(description="Build the site of the documents.")
    parser.add_argument("folder", type=Path, help="what is in it is replaced")
    folder = parser.parse_args().folder
    if folder.exists() and not (folder / "sitemap.xml").exists():
        parser.error(f"{folder} is there and is no such site; name another folder")
    shutil.rmtree(folder, ignore_errors=True)
    warnings = build(folder)
    print(f"{folder / 'index.html'}: {warnings} warnings")
    return int(warnings > 0)


if __name__ == "__main__":
    sys.exit(main())
