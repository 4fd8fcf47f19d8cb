"""The recipes of CONTRIBUTING.md, followed in a copy of the package: each file that they name, and no other."""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path

import pytest

from tests.conftest import finished
from tests.test_docs import ROOT

SHIPPED = ROOT / "recordings" / "mujoco-amd-r0.mcap"


class Copy:
    """A copy of the package in a folder of its own; commands run in it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.package = folder / "src" / "gpusimbench"
        shutil.copytree(ROOT / "src", folder / "src", ignore=shutil.ignore_patterns("__pycache__"))

    def write(self, name: str, text: str) -> None:
        """Make a file that a recipe names."""
        path = self.package / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")

    def edit(self, name: str, before: str, after: str) -> None:
        """Change a line of a file that a recipe names."""
        path = self.package / name
        text = path.read_text(encoding="utf-8")
        assert text.count(before) == 1, f"{name} has changed: {before}"
        path.write_text(text.replace(before, after), encoding="utf-8")

    def run(self, *command: str, code: int = 0) -> str:
        """What a command that ends with that exit code prints on standard output."""
        done = finished(
            [sys.executable, "-P", "-m", *command],
            cwd=self.folder,
            env={**os.environ, "PYTHONPATH": str(self.folder / "src")},
            code=code,
        )
        return done.stdout


@pytest.fixture
def copy(tmp_path: Path) -> Copy:
    """A fresh copy."""
    return Copy(tmp_path)


@pytest.mark.slow
def test_add_a_scene(copy: Copy) -> None:
    """Record a new scene on an engine that does not know it."""
    copy.write(
        "recorder/scenes/one_ball.py",
        '''"""A ball falls onto a ground plane."""

from __future__ import annotations

from gpusimbench.recorder.scenes.base import Body, Plane, Scene, Sphere
from gpusimbench.recorder.scenes.cube_stack import ROUGH_WOOD


def one_ball() -> Scene:
    """The scene."""
    ball = Body("ball", Sphere(0.05), ROUGH_WOOD, position=(0.0, 0.0, 0.5), mass=0.2, group="balls")
    return Scene(
        name="one-ball", summary="a ball falls", parameters={},
        bodies=(Body("ground", Plane(), ROUGH_WOOD, position=(0.0, 0.0, 0.0)), ball),
    )
''',
    )
    copy.edit("recorder/scenes/registry.py", '    "franka",\n', '    "franka",\n    "one-ball",\n')
    listed = json.loads(copy.run("gpusimbench.recorder.cli", "--list", "--json"))
    assert "one-ball" in [scene["name"] for scene in listed["scenes"]]
    assert "one-ball" in next(s for s in listed["simulators"] if s["name"] == "newton")["scenes"]
    wanted = ["--scene", "one-ball", "--n-env", "2", "--runs", "1", "--steps", "20", "--phases", "capture"]
    copy.run("gpusimbench.recorder.cli", "--sim", "mujoco", *wanted, "--out", "made")
    assert len(list((copy.folder / "made").glob("*one-ball*.mcap"))) == 1


@pytest.mark.slow
def test_add_an_engine(copy: Copy) -> None:
    """Record with a new engine a scene that does not know it, and refuse a scene by the ability that is missing."""
    copy.write(
        "recorder/simulators/twin/simulator.py",
        '''"""MuJoCo C once more, without robots."""

from __future__ import annotations

from gpusimbench.recorder.abilities import Ability
from gpusimbench.recorder.simulators.mujoco.simulator import MujocoC


class Twin(MujocoC):
    """The adapter."""

    abilities = MujocoC.abilities - {Ability.FIXED_BASE}
''',
    )
    copy.write("recorder/simulators/twin/__init__.py", "")
    copy.edit(
        "recorder/simulators/registry.py",
        "BUILT_IN = (\n",
        'BUILT_IN = (\n    _engine("twin", "a twin", "Twin", "mujoco"),\n',
    )
    wanted = ["--scene", "free-fall", "--n-env", "2", "--runs", "1", "--steps", "20", "--phases", "capture"]
    copy.run("gpusimbench.recorder.cli", "--sim", "twin", *wanted, "--out", "made")
    assert len(list((copy.folder / "made").glob("twin*.mcap"))) == 1
    twin = next(
        s
        for s in json.loads(copy.run("gpusimbench.recorder.cli", "--list", "--json"))["simulators"]
        if s["name"] == "twin"
    )
    assert "franka" not in twin["scenes"]
    assert "fixed-base" in str(twin["refused"]["franka"])


@pytest.mark.slow
def test_add_an_intervention(copy: Copy) -> None:
    """Record a new intervention, which gsb-probe plans, and answer the question about it."""
    copy.edit(
        "schemas/treatment.py",
        "_KINDS = (\n",
        '_KINDS = (\n    InterventionKind("again", "saves the state and restores it at once"),\n',
    )
    copy.edit(
        "recorder/run/intervention.py",
        "] = {\n",
        '] = {\n    "again": (lambda claims: claims.snapshot, '
        "lambda asked: asked.simulator.restore(asked.simulator.snapshot())),\n",
    )
    copy.edit(
        "evaluator/probe/questions.py",
        "QUESTIONS = (\n",
        'QUESTIONS = (\n    Question("again", "a state that is restored at once goes on", '
        'goes_on("again", "restored at step {step}")),\n',
    )
    assert "again@STEP saves the state" in " ".join(copy.run("gpusimbench.recorder.cli", "--help-all").split())
    few = ["--n-env", "2", "--numbers", "1", "--steps", "30", "--out", "made", "--json", "answers.json"]
    copy.run("gpusimbench.evaluator.cli.probe", "--sim", "mujoco", "--scene", "free-fall", *few)
    (probe,) = json.loads((copy.folder / "answers.json").read_text(encoding="utf-8"))["probes"]
    assert {one["key"]: one["answer"] for one in probe["answers"]}["again"] == "yes"


@pytest.mark.slow
def test_add_an_option_of_the_recorder(copy: Copy) -> None:
    """Keep what a new option was given in the recording, in its replay, and wherever results tell settings apart."""
    copy.edit(
        "schemas/configuration.py",
        "    keep: str = _setting(",
        "    rate: float = _setting(\n        lambda record, name: checks.number(record, name, 0, 1e6, default=0), "
        "'controller rate', empty=0.0, bits=True\n    )\n    keep: str = _setting(",
    )
    copy.edit(
        "recorder/command/arguments.py",
        '    take("--replay"',
        '    take("--rate", type=float, metavar="HZ", help="of the controller [Hz] (default: none)", simulated=0.0)\n'
        '    take("--replay"',
    )
    wanted = ["--scene", "free-fall", "--n-env", "2", "--runs", "1", "--steps", "20", "--phases", "capture"]
    for folder, rate in (("made", "50"), ("other", "100")):
        copy.run("gpusimbench.recorder.cli", "--sim", "mujoco", *wanted, "--rate", rate, "--out", folder)
    (first,), (other,) = ((copy.folder / name).glob("*.mcap") for name in ("made", "other"))
    copy.run("gpusimbench.recorder.cli", "--replay", str(first), "--out", "replayed")
    (second,) = (copy.folder / "replayed").glob("*.mcap")
    for path in (first, second):
        (told,) = json.loads(copy.run("gpusimbench.evaluator.cli.info", str(path), "--json", "-"))["files"]
        assert told["provenance"]["configuration"]["rate"] == 50
    assert " rate 50 " in " ".join(copy.run("gpusimbench.evaluator.cli.info", str(first)).split())
    files = [str(path) for path in (first, second, other)]
    copy.run("gpusimbench.evaluator.cli.eval", *files, "--json", "found.json", "--html", "page", "--no-cache")
    groups = json.loads((copy.folder / "found.json").read_text(encoding="utf-8"))["groups"]
    assert [(group["label"], group["rate"], group["n_run"]) for group in groups] == [
        ("mujoco [rate=50]", 50, 2),
        ("mujoco [rate=100]", 100, 1),
    ]
    assert "controller rate" in (copy.folder / "page" / "index.html").read_text(encoding="utf-8")
    across = copy.run("gpusimbench.evaluator.cli.compare", str(first), str(other), code=5)
    assert "differs in rate: 50.0 -> 100.0" in " ".join(across.split())


@pytest.mark.slow
def test_add_an_option_of_a_simulator(copy: Copy) -> None:
    """List a new option, and tell groups apart by its value, also where the engine does not say it."""
    file = "recorder/simulators/mujoco/simulator.py"
    copy.edit(file, "    threads    0: as", "    flavour    any number\n    threads    0: as")
    copy.edit(file, "    threads: int = 0\n", "    threads: int = 0\n    flavour: int = 0\n")
    assert "any number" in copy.run("gpusimbench.recorder.cli", "--list", "mujoco")
    wanted = ["--scene", "free-fall", "--n-env", "2", "--runs", "1", "--steps", "20", "--phases", "capture"]
    for value in (1, 2):
        copy.run("gpusimbench.recorder.cli", "--sim", "mujoco", *wanted, f"--option=flavour={value}", "--out", "made")
    files = sorted(str(path) for path in (copy.folder / "made").glob("*.mcap"))
    copy.run("gpusimbench.evaluator.cli.eval", *files, "--json", "found.json", "--no-cache")
    groups = json.loads((copy.folder / "found.json").read_text(encoding="utf-8"))["groups"]
    assert [(group["label"], group["options"]["flavour"]) for group in groups] == [
        ("mujoco [flavour=1]", "1"),
        ("mujoco [flavour=2]", "2"),
    ]


@pytest.mark.slow
def test_add_a_section_of_the_report(copy: Copy) -> None:
    """Show a new section in the page."""
    copy.write(
        "evaluator/report/sections/greeting.py",
        '''"""A greeting."""

from __future__ import annotations

from gpusimbench.evaluator.render.document import Section, Text
from gpusimbench.evaluator.report.source import Source


def section(source: Source) -> Section:
    """How many groups there are."""
    return Section("greeting", "A greeting", (Text(f"There are {len(source.evaluation.results)} groups."),))
''',
    )
    copy.edit(
        "evaluator/report/document.py", "    deviations.section,\n", "    greeting.section,\n    deviations.section,\n"
    )
    copy.edit("evaluator/report/document.py", "    episodes,\n", "    episodes,\n    greeting,\n")
    copy.run("gpusimbench.evaluator.cli.eval", str(SHIPPED), "--html", "report", "--no-cache")
    page = (copy.folder / "report" / "index.html").read_text(encoding="utf-8")
    assert "<p>There are 1 groups.</p>" in page
    assert "A greeting" in page
