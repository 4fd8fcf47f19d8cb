"""What importing an adapter's module may not do."""

from __future__ import annotations

import json
import os
import subprocess
import sys

from gpusimbench.recorder.conformance.subject import Subject
from gpusimbench.recorder.conformance.verdict import NotApplicable, expect

_DEVICE_LIBRARIES = ("cupy", "genesis", "jax", "jaxlib", "mujoco", "newton", "sapien", "taichi", "torch", "warp")
"""Import names of libraries that engines compute with; whatever the registry says of an adapter is added."""

_LIGHT = ("psutil",)  # required by all adapters, harmless to import

_CODE = """
import json, sys
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec

engines, asked = set(sys.argv[2:]), []

class Absent(MetaPathFinder, Loader):
    def find_spec(self, name, path=None, target=None):
        return ModuleSpec(name, self) if name.partition(".")[0] in engines else None

    def create_module(self, spec):
        asked.append(spec.name)
        raise ImportError(f"{spec.name} is not there")

    def exec_module(self, module):
        raise NotImplementedError

sys.meta_path.insert(0, Absent())
problem = ""
try:
    import_module(sys.argv[1])
except BaseException as error:
    problem = f"{type(error).__name__}: {error}"
print(json.dumps([asked, problem]))
"""


def importing_needs_no_engine(subject: Subject) -> None:
    """Import the adapter's module where no engine is installed: engines are imported in build."""
    module = subject.adapter.__module__
    if module == "__main__":
        raise NotApplicable("the adapter lives in no module that could be imported")
    required = subject.entry.requires if subject.entry else ()
    engines = sorted({name.partition(".")[0] for name in (*_DEVICE_LIBRARIES, *required)} - set(_LIGHT))
    done = subprocess.run(
        [sys.executable, "-c", _CODE, module, *engines],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    expect(done.returncode == 0, f"importing {module} ended Python: {done.stderr.strip()[-300:]}")
    asked, problem = json.loads(done.stdout.splitlines()[-1])
    expect(not asked, f"importing {module} imports {', '.join(asked)}; expected no engine before build")
    expect(not problem, f"importing {module} where no engine is installed: {problem}")
