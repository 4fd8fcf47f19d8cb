"""Redraws the tables of docs/how-to/what-the-importer-lost.md: what engines make of the walker and Gymnasium's models.

usage: python docs/make_imports.py [--columns warp,isaaclab-newton,...] [--models walker,ant,...] [--folder FOLDER]

Measures these columns and models, and shows all results that are in the folder; what is not there stays as the page has
it, so that columns can be added one by one.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from page_blocks import block, redraw

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "how-to" / "what-the-importer-lost.md"
COLUMNS = {
    "warp": "warp",
    "mjx": "mjx",
    "newton": "newton",
    "physx": "physx",
    "isaaclab-newton": "isaaclab, backend newton",
    "genesis": "genesis",
}
"""Names of columns in files and arguments, an engine and, behind a hyphen, its backend; and their titles."""

_NO_PGS = ("warp", "mjx", "newton")
"""Columns of engines without the solver PGS."""


def models() -> dict[str, Path]:
    """The walker of the examples, and the models of Gymnasium as it is installed."""
    found = find_spec("gymnasium")
    assert found is not None and found.origin is not None
    assets = Path(found.origin).parent / "envs" / "mujoco" / "assets"
    files = [ROOT / "examples" / "walker" / "walker.xml", *sorted(assets.glob("*.xml"))]
    return {path.stem: path for path in files}


def measured(model: Path, column: str, folder: Path) -> dict[str, Any]:
    """What gsb-import says of an engine, from the folder if it was asked before."""
    target = folder / f"{model.stem}-{column}.json"
    if not target.exists():
        engine, _, backend = column.partition("-")
        given = [str(model), "--sim", engine, "--out", str(folder / "runs"), "--json", str(target)]
        given += ["--option", f"backend={backend}"] if backend else []
        given += ["--option", "solver=Newton"] if "PGS" in model.read_text() and column in _NO_PGS else []
        command = [sys.executable, "-m", "gpusimbench.evaluator.cli.imported", *given]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode in (0, 4), done.stderr
    result: dict[str, Any] = json.loads(target.read_text())["engines"][0]
    return result


def short(found: dict[str, Any]) -> str:
    """A cell: what differs."""
    if found["missing"]:
        return "refused"
    findings = [finding for kind in found["kinds"] for finding in kind["findings"]]
    wrong = [f"{len(findings)} parameter{'s' if len(findings) > 1 else ''}"] if findings else []
    poses, responses = found["poses"], found["responses"]
    distance = max((link["distance"] for link in poses["links"]), default=0.0) if poses else None
    if distance is not None and distance > 1e-5:
        wrong.append(f"bodies by {distance:.2g} m")
    late = [one["steps"] for one in responses["each"] if one["steps"] is not None] if responses else []
    if late and max(late) > 0.1:
        wrong.append(f"responses by {max(late):.2g} steps")
    return f"**differs**: {', '.join(wrong)}" if wrong else "agrees"


def table(folder: Path, present: str) -> str:
    """A row for each model, a column for each engine and backend, in Markdown; what is not in the folder is as in
    `present`, or a dash."""
    lines = [[cell.strip() for cell in line.strip("| ").split("|")] for line in present.strip().splitlines()]
    shown = {(row[0], title): cell for row in lines[2:] for title, cell in zip(lines[0][1:], row[1:], strict=True)}
    rows = [["model", *COLUMNS.values()], ["---"] * (len(COLUMNS) + 1)]
    for name, path in models().items():
        cells = []
        for column, title in COLUMNS.items():
            there = (folder / f"{name}-{column}.json").exists()
            cells.append(short(measured(path, column, folder)) if there else shown.get((name, title), "-"))
        rows.append([name, *cells])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def main() -> None:
    """Measure, and write the table into the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--columns", default=",".join(COLUMNS))
    parser.add_argument("--models", default="")
    parser.add_argument("--folder", type=Path, default=Path("import-results"))
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    known = models()
    for name in given.models.split(",") if given.models else known:
        for column in given.columns.split(","):
            print(name, column, short(measured(known[name], column, given.folder)), flush=True)
    redraw(PAGE, {"imports": table(given.folder, block(PAGE.read_text(encoding="utf-8"), "imports"))})


if __name__ == "__main__":
    main()
