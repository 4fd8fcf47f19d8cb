"""Commands start fast because nothing heavy is imported before it is needed."""

from __future__ import annotations

import pytest

from tests.conftest import loaded_by_reading, run_python

HEAVY = (
    "numpy",
    "scipy",
    "mujoco",
    "jax",
    "torch",
    "warp",
    "matplotlib",
    "polars",
    "rich",
    "jinja2",
    "google.protobuf",
    "mcap",
    "zstandard",
)


@pytest.mark.parametrize(
    "module",
    [
        "gpusimbench.cli",
        "gpusimbench.recorder.cli",
        *(
            f"gpusimbench.evaluator.cli.{name}"
            for name in ("audit", "check", "compare", "diff", "eval", "info", "share", "view")
        ),
    ],
)
def test_help_imports_nothing_heavy(module: str) -> None:
    """Print help and version without a numerical library, a simulator, a file format or, to evaluate, the recorder."""
    heavy = HEAVY if ".recorder." in module else (*HEAVY, "gpusimbench.recorder")
    heavy = (*heavy, "gpusimbench.evaluator") if module == "gpusimbench.cli" else heavy
    code = (
        f"import sys\nfrom {module} import main\n"
        "for argument in ('--help', '--version'):\n"
        "    try:\n        main([argument])\n    except SystemExit as end:\n        assert not end.code, end.code\n"
        f"print([m for m in {heavy!r} if m in sys.modules], file=sys.stderr)"
    )
    done = run_python(code)
    assert done.stdout
    assert done.stderr.strip() == "[]"


@pytest.mark.parametrize(
    "module",
    [
        "gpusimbench.evaluator.results.evaluate",
        "gpusimbench.evaluator.report.document",
        "gpusimbench.evaluator.compare.compare",
    ],
)
def test_evaluation_needs_no_simulator(module: str) -> None:
    """Import no simulator, JAX, torch, or recorder, and SciPy and numba when something is computed by them alone."""
    code = (
        f"import sys, {module}\n"
        "others = ('mujoco', 'jax', 'torch', 'warp', 'pynvml', 'psutil', 'gpusimbench.recorder', 'scipy', 'numba')\n"
        "print([m for m in others if m in sys.modules])"
    )
    done = run_python(code)
    assert done.stdout.strip() == "[]"


def test_adapters_import_no_engine() -> None:
    """Import the adapters of all simulators without any engine: each is imported when a run builds it."""
    done = run_python(
        "import sys\nfrom gpusimbench.recorder.simulators.registry import BUILT_IN\n"
        "needed = {name for entry in BUILT_IN for name in entry.requires} - {'psutil'}\n"
        "assert {'mujoco', 'warp', 'jax'} <= needed\n"
        "for entry in BUILT_IN:\n    entry.adapter()\n"
        "print(sorted(needed & sys.modules.keys()))"
    )
    assert done.stdout.strip() == "[]"


def test_a_run_of_a_built_in_simulator_begins_fast() -> None:
    """Find it without a look into every installed distribution; describe MuJoCo's shapes without masked arrays."""
    done = run_python(
        "import sys\nfrom importlib import metadata\n"
        "metadata.entry_points = None\n"
        "from gpusimbench.recorder.simulators.registry import find_simulator\n"
        "assert find_simulator('mujoco').name == 'mujoco'\n"
        "import gpusimbench.recorder.simulators.mujoco.geometry\n"
        "print('numpy.ma' in sys.modules)"
    )
    assert done.stdout.strip() == "False"


def test_tests_are_read_without_an_engine() -> None:
    """Import no engine before a test needs it (`needed` of recorder/engines.py): every process reads all files."""
    assert not loaded_by_reading
