"""What command lines of benchmarks have in common: whole numbers by name, and a table that is printed and written."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path


def parser(doc: str | None, **numbers: int) -> argparse.ArgumentParser:
    """With an option for each whole number: n_env=64 makes --n-env, with 64 as the default."""
    made = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in numbers.items():
        made.add_argument(f"--{name.replace('_', '-')}", type=int, default=default)
    return made


def of_counts(doc: str | None, **numbers: int) -> argparse.ArgumentParser:
    """The same of a benchmark that counts over seeds, and writes a table of what it counted."""
    made = parser(doc, **numbers, repetitions=40)
    made.add_argument("--seed", type=int, default=1, help="of the first recording")
    made.add_argument("--out", type=Path, help="file for the table, which docs/make_power.py puts into the page")
    return made


def end_table(lines: Sequence[str], said: str, out: Path | None) -> None:
    """Print what is said below a table whose lines were printed, and write both where there is a file for them."""
    print(f"\n{said}")
    if out:
        out.write_text("\n".join([*lines, "", said]) + "\n", encoding="utf-8")
