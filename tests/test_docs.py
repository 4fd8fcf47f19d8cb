"""Every command and every program that the documents show runs as shown."""

from __future__ import annotations

import glob
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from scipy.stats import binomtest

from gpusimbench.evaluator.runs.validation import verify
from tests.conftest import call, command, distribution, finished, run_python, searched
from tests.scripts import drawn, script

ROOT = Path(__file__).resolve().parent.parent
DOCUMENTS = sorted(
    p for p in ROOT.rglob("*.md") if not any(part.startswith(".") or part == "node_modules" for part in p.parts)
)


def blocks(document: Path, language: str) -> list[str]:
    """Fenced blocks of one language."""
    return re.findall(rf"^```{language}\n(.*?)^```", document.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


def commands(document: Path) -> list[str]:
    """Commands of the console blocks, one a line."""
    return [line for block in blocks(document, "console") for line in block.splitlines() if line.strip()]


def plain(line: str, folder: Path) -> list[str]:
    """The words of a line that runs a command of ours, names of files filled in as a shell does; none where the line
    asks a shell for more, or the command starts what would stay in this process."""
    if not line.startswith("gsb-") or "--ray" in line or set(line) & set("$`|&;<>(){}~#'\\\""):
        return []
    words = []
    for word in line.split():
        words += sorted(glob.glob(word, root_dir=folder)) or [word]
    return words


def shell(line: str, folder: Path, environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """Run a line of a page as a shell would, with the installed commands first on the path.

    A line that asks a shell for files' names alone is run without it, and a command of ours in this process, as `call`
    does: a process for each would load the same modules for a second.
    AssertionError where it ends with another exit code than 0, or than the one that a comment in the line announces.
    """
    line, _, expected = line.partition("  # exit code ")
    path = os.pathsep.join([str(Path(command("gsb-eval")[0]).parent), os.environ["PATH"]])
    env = {**os.environ, **(environment or {}), "PATH": path}
    if words := plain(line, folder):
        done = call(*words, cwd=folder, env=env)
    else:
        done = subprocess.run(line, shell=True, cwd=folder, capture_output=True, text=True, timeout=900, env=env)
    assert done.returncode == int(expected or 0), f"{line}\n{done.stdout}\n{done.stderr}"
    return done


FENCE = re.compile(r'^```(\w*)(?: title="([^"]+)")?\n(.*?)^```$', re.DOTALL | re.MULTILINE)


def walk(page: Path, folder: Path, environment: dict[str, str]) -> int:
    """Do what a page tells its reader, from top to bottom, in one folder; returns how many commands that were.

    A block with a file's name as its title is written to that file. A console block is run, each line with the exit
    code that a comment announces. What a text block behind it shows is printed, where ... stands for anything.
    """
    printed, n_command = "", 0
    for language, title, text in FENCE.findall(page.read_text(encoding="utf-8")):
        if title:
            (folder / title).write_text(text, encoding="utf-8")
        elif language == "console":
            printed = ""
            for line in text.strip().splitlines():
                printed += shell(line, folder, environment).stdout
                n_command += 1
        elif language == "text":
            assert shows(text, printed), f"{page.name} shows\n{text}\nand this was printed\n{printed}"
            printed = ""
    return n_command


def shows(page: str, printed: str) -> bool:
    """Whether a page shows what was printed, however wide its columns; "..." stands for anything."""
    shown, real = (" ".join(text.split()) for text in (page, printed))
    parts = [re.escape(part.strip()) for part in shown.split("...")]
    return re.fullmatch(r"\s*" + r".*?".join(rf"{part}\s*" for part in parts), real, re.DOTALL) is not None


def test_what_a_page_shows() -> None:
    """Take a line that is not printed, or printed in another order, for a difference."""
    assert shows("a  1\n...\nd", "a 1\nb 2\nc 3\nd\n")
    assert shows("throughput  ...  1 of 2", "throughput 3.4 ± 1 1 of 2")
    assert not shows("a\nb", "a\nc\nb")
    assert not shows("a\n...\nb", "b\na")
    assert not shows("a", "a b")


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("setuptools") is None, reason="setuptools, which builds, is not installed")
def test_the_tutorial(tmp_path: Path) -> None:
    """Go through the tutorial in an empty folder: install its package, record, evaluate, and see what it shows."""
    site = tmp_path / "site"
    folder = tmp_path / "springs"
    folder.mkdir()
    path = searched(site, ROOT)
    installing = {"TARGET": str(site), "NO_INDEX": "1", "NO_DEPS": "1", "NO_BUILD_ISOLATION": "0",
                  "DISABLE_PIP_VERSION_CHECK": "1"}  # fmt: skip
    environment = {"PYTHONPATH": path, **{f"PIP_{name}": value for name, value in installing.items()}}
    assert walk(ROOT / "docs" / "tutorial.md", folder, environment) == 11


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [*sorted((ROOT / "docs" / "how-to").glob("*.md")), ROOT / "docs" / "gpu-memory.md"],
    ids=lambda page: page.stem,
)
def test_the_how_tos(page: Path, tmp_path: Path) -> None:
    """Do what a page of instructions says in a folder that has the sample recordings."""
    for name in ("recordings", "examples"):
        (tmp_path / name).symlink_to(ROOT / name)
    assert walk(page, tmp_path, {}) > 0


_SHORTER = {
    ("README.md", "gsb-record --sim"): " --steps 50 --timed-steps 50",
    ("README.md", "gsb-probe --sim"): " --n-env 4 --steps 30",
    ("docs/recording.md", "--runs 3"): " --steps 50 --timed-steps 50",
}
"""What is appended to lines of a page with these words, as the page shows no number of theirs; test_make_demo runs the
README's first command with all its steps."""


@pytest.mark.slow
@pytest.mark.usefixtures("unoptimised")
@pytest.mark.parametrize(
    "page",
    [
        "README.md",
        *(f"docs/{name}.md" for name in ("metrics", "recording", "regimes", "timing")),
        pytest.param("docs/scale.md", marks=pytest.mark.alone),
    ],
)
def test_commands_of_a_page(page: str, tmp_path: Path) -> None:
    """Run every command of a page in a folder that has the sample recordings."""
    few = shutil.ignore_patterns("[a-oq-z]*-n*.mcap")  # of those of GPUs: physx, which the README names
    shutil.copytree(ROOT / "recordings", tmp_path / "recordings", ignore=few)
    lines = commands(ROOT / page)
    assert lines
    for line in lines:
        shorter = [more for (where, words), more in _SHORTER.items() if where == page and words in line]
        assert shell("".join([line, *shorter]), tmp_path).stdout
    if page == "README.md":  # what make demo makes, too
        assert len(list((tmp_path / "runs").glob("mujoco-inclined-collision-n16-*.mcap"))) == 10


def test_readme_python() -> None:
    """Run every Python block of the README from the repository's root."""
    for block in blocks(ROOT / "README.md", "python"):
        done = run_python(block, cwd=ROOT)
        assert "(501, 16, 27, 3)" in done.stdout


@pytest.mark.slow
def test_the_adapter_of_the_guide(tmp_path: Path) -> None:
    """Write the guide's adapter and its entry point as shown, and run the guide's commands with it."""
    guide = ROOT / "docs" / "your-simulator.md"
    (adapter,) = blocks(guide, "python")
    (project,) = blocks(guide, "toml")
    (tmp_path / "ballistic.py").write_text(adapter)
    found = re.search(r'\[project.entry-points."gsb.simulators"\]\n(.*)\n', project)
    distribution(tmp_path, "ballistic", f"[gsb.simulators]\n{found[1].replace(chr(34), '')}\n")
    environment = {"PYTHONPATH": searched(tmp_path, ROOT)}
    for line in commands(guide):
        shell(line, tmp_path, environment)
    assert "ballistic" in shell("gsb-record --list", tmp_path, environment).stdout


@pytest.mark.parametrize("document", DOCUMENTS, ids=str)
def test_intervals_hold_their_values(document: Path) -> None:
    """Find no value outside of its interval, no deviation of 0, and shares within Clopper's and Pearson's limits."""
    page = document.read_text(encoding="utf-8")
    for value, low, high in re.findall(r"(?<!± )(?<![\d.,])(-?\d[\d.,]*) \[(-?[\d.,]+) to (-?[\d.,]+)\]", page):
        numbers = [float(number.replace(",", "")) for number in (low, value, high)]
        assert numbers == sorted(numbers), f"{value} [{low} to {high}]"
    assert not re.search(r"± 0(\.0+)?(?![\d.e])", page), "a deviation that is not zero is never printed as zero"
    number = r"([\d.]+)%"
    for k, n, *shown in re.findall(rf"(\d+) of (\d+): {number} \[{number} to {number}\]", page):
        exact = binomtest(int(k), int(n)).proportion_ci(0.95)
        shares = [f"{100 * share:.1f}" for share in (int(k) / int(n), exact.low, exact.high)]
        assert shown == shares, f"{k} of {n}"


@pytest.mark.parametrize("document", [p for p in DOCUMENTS if "<!-- end of " in p.read_text(encoding="utf-8")], ids=str)
def test_what_scripts_draw_can_be_drawn_again(document: Path) -> None:
    """Find both markers of every table that a script draws, in pairs, and the script; other bytes stay as they are."""
    page = document.read_text(encoding="utf-8")
    marks = dict(re.findall(r"^<!-- (.+?): (.+) -->$", page, re.MULTILINE))
    assert sorted(marks) == sorted(re.findall(r"^<!-- end of (.+) -->$", page, re.MULTILINE))
    assert all(by == "make figures" or (ROOT / by).is_file() for by in marks.values())
    with_blocks = script("page_blocks").with_blocks
    changed = with_blocks(page, dict.fromkeys(marks, "| drawn |"))
    assert changed.count("-->\n| drawn |\n<!-- end of ") == len(marks)
    assert with_blocks(changed, {name: drawn(document, name) for name in marks}) == page


def test_readme_table_is_what_the_recordings_give() -> None:
    """Hold the README's table and picture to the recordings that they are of."""
    figures = script("make_figures")
    evaluation = figures.shipped()
    assert figures.table(evaluation) == drawn(ROOT / "README.md", "table"), "run make figures"
    kept = (ROOT / "docs" / "figures" / "density.svg").read_text(encoding="utf-8")
    assert figures.picture(evaluation) == kept, "run make figures"


def test_the_moving_picture_is_what_the_recordings_give() -> None:
    """Hold the README's second picture to the recordings that it is of."""
    kept = (ROOT / "docs" / "figures" / "parting.svg").read_text(encoding="utf-8")
    assert script("make_loop").loop() == kept, "run make figures"


def test_sample_recordings_are_whole() -> None:
    """Ship recordings that are complete, verify, name no machine's paths and stay small."""
    from gpusimbench import open_recording

    files = sorted((ROOT / "recordings").glob("*.mcap"))
    assert len(files) >= 8
    assert sum(f.stat().st_size for f in files) < 60e6
    for file in files:
        recording = open_recording(file)
        verify(recording)
        assert recording.status == "complete"
        for name in recording.attachment_names():
            text = (recording.attachment(name) or b"").decode()
            assert not re.search(r"/(home|root|work|tmp|Users)/", text), f"{file.name}: {name}"


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_somewhere(document: Path) -> None:
    """Point every relative link at a file that exists."""
    for target in re.findall(r"\]\(([^)#]+)", document.read_text(encoding="utf-8")):
        if not target.startswith(("http:", "https:")):
            assert (document.parent / target).exists(), f"{document.name}: {target}"


def test_the_index_has_every_page() -> None:
    """List each page of the folder, as the heading of its list says."""
    folder = ROOT / "docs"
    named = set(re.findall(r"\]\(([^)#]+)", (folder / "index.md").read_text(encoding="utf-8")))
    assert {page.relative_to(folder).as_posix() for page in folder.rglob("*.md")} - named == {"index.md"}


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_make_demo(tmp_path: Path) -> None:
    """Record, evaluate and report with the README's first command: of fewer runs than test_commands_of_a_page makes
    with the same command."""
    # an environment that other checkouts share must not be made to import this checkout
    installed = f"--old-file={sys.prefix}/.installed-demo"
    given = ["make", "demo", f"VENV={sys.prefix}", f"OUT={tmp_path / 'demo'}", installed]
    planned = finished([*given, "--dry-run"], cwd=ROOT).stdout
    assert f"gsb-record --sim mujoco --out {tmp_path / 'demo'} \n" in planned
    assert "pip install" not in planned
    done = finished([*given, "MORE=--runs 2"], cwd=ROOT, timeout=900)
    assert len(list((tmp_path / "demo").glob("*.mcap"))) == 2
    assert "16 envs, 2 complete runs" in done.stdout
    assert str(tmp_path / "demo" / "report" / "index.html") in done.stdout


def test_how_to_cite() -> None:
    """Name the version and the licence of the package, an author, and the format that the file is in."""
    from gpusimbench import schemas

    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    said = dict(re.findall(r"^([\w-]+): (.+)$", text, re.MULTILINE))
    assert said["cff-version"] == "1.2.0"
    assert said["version"] == schemas.__version__
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert (said["title"], said["license"]) == (project["name"], project["license"])
    assert "Apache License" in (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert re.search(r"^authors:\n  - name: \S", text, re.MULTILINE)
    assert said["message"]
