"""What an adapter says of itself; and what importing its module may not do."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import subprocess
import sys

from gpusimbench.recorder.abilities import titles
from gpusimbench.recorder.conformance.subject import Subject
from gpusimbench.recorder.conformance.trajectory import FRAMES
from gpusimbench.recorder.conformance.verdict import NotApplicable, expect
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.base import Description, States
from gpusimbench.schemas.fields import DTYPES, FIELD_KINDS

_JOINT_FIELDS = ("qpos", "qvel")
_PER = ("env", "all")

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


def class_keeps_the_contract(subject: Subject) -> None:
    """Options is a frozen dataclass whose fields all have defaults; levels, interval and environment are as asked."""
    adapter, kind = subject.adapter, subject.adapter.Options
    expect(dataclasses.is_dataclass(kind), f"Options is a dataclass, not {kind!r}")
    parameters = getattr(kind, "__dataclass_params__", None)
    expect(parameters is not None and parameters.frozen, f"{kind.__name__} is not frozen")
    try:
        kind()
    except TypeError as error:
        raise AssertionError(f"{kind.__name__} has a field without a default: {error}") from None
    undeclared = titles(adapter.withheld(kind()).keys() - adapter.abilities)
    expect(not undeclared, f"withheld() names what is not among the abilities: {', '.join(undeclared)}")
    levels = adapter.determinism_levels
    expect("default" in levels, f"determinism_levels has no 'default': {sorted(levels)}")
    unsaid = sorted(level for level, meaning in levels.items() if not meaning)
    expect(not unsaid, f"determinism levels that say nothing of what they set: {unsaid}")
    expect(adapter.timing_interval >= 1, f"timing_interval is at least 1, not {adapter.timing_interval}")
    for level in levels:
        variables = adapter.environment(kind(), level)
        text = all(isinstance(part, str) for pair in variables.items() for part in pair)
        expect(text, f"environment('{level}') gives text by name, not {variables}")


def says_what_it_is(subject: Subject) -> None:
    """Version, device, what the clocks cover and the options that were given are there, and fit into a recording."""
    description = subject.trajectory.description
    for name in ("version", "device", "timing_covers"):
        expect(bool(getattr(description, name)), f"the description's {name} is empty")
    said = {*description.options, *description.switches, *(buffer.name for buffer in description.buffers), "device"}
    # of those that were not given some may not be in force, as of a solver that was not chosen
    missing = [name for name in subject.given if name not in said]
    expect(not missing, f"options that were given and that the description does not tell: {', '.join(missing)}")
    for name in ("options", "switches"):
        try:
            json.dumps(getattr(description, name))
        except (TypeError, ValueError) as error:
            raise AssertionError(f"the description's {name} cannot be written as JSON: {error}") from None
    for deviation in description.deviations:
        empty = [f.name for f in dataclasses.fields(deviation) if not getattr(deviation, f.name)]
        expect(not empty, f"deviation {deviation.parameter or '?'} says nothing of: {', '.join(empty)}")
    for name, (media_type, data) in description.attachments.items():
        expect(bool(media_type) and isinstance(data, bytes), f"attachment {name} is (media type, bytes)")
    origins = len(description.env_origins)
    expect(origins in (0, subject.trajectory.n_env), f"{origins} env_origins for {subject.trajectory.n_env} envs")
    finite = all(math.isfinite(x) for origin in description.env_origins for x in origin)
    expect(finite, f"env_origins are not all finite: {description.env_origins}")
    memory = subject.trajectory.allocator
    expect(memory is None or 0 <= memory[0] <= memory[1], f"allocator_bytes is (in use, peak), not {memory}")
    if subject.entry and subject.entry.devices:
        kind = "cpu" if description.device == "cpu" else "cuda"
        expect(kind in subject.entry.devices, f"device {description.device} is none of {subject.entry.devices}")


def layout_is_as_the_format_asks(subject: Subject) -> None:
    """Fields have the format's units, frames and components, and arrays their shapes and dtypes."""
    trajectory = subject.trajectory
    expect_layout(subject, trajectory.scene, trajectory.description, trajectory.described, trajectory.n_env)
    rows = sum(trajectory.blocks) + 1
    for layout, array in zip(trajectory.description.fields, trajectory.states, strict=True):
        shape = (rows, trajectory.n_env, len(layout.items), layout.width)
        expect(array.shape == shape, f"states() gives {layout.name} for {rows - 1} steps: {array.shape}, not {shape}")
        expect(array.dtype == layout.dtype, f"states() gives {layout.name} as {array.dtype}, not {layout.dtype}")


def expect_layout(subject: Subject, scene: Scene, description: Description, state: States, n_env: int) -> None:
    """AssertionError where the fields that are described, or the arrays of a state, are not as they should be."""
    names = [layout.name for layout in description.fields]
    expect(bool(names), "the description has no fields: nothing would be recorded")
    expect(len(set(names)) == len(names), f"fields are described twice: {names}")
    expect(len(state) == len(names), f"{len(names)} fields are described, and state() gives {len(state)} arrays")
    groups = scene.groups()
    joints = tuple(joint.name for joint in scene.robot.joints()) if scene.robot else ()
    for layout, array in zip(description.fields, state, strict=True):
        expect(layout.field in FIELD_KINDS, f"{layout.name}: a field is one of {', '.join(FIELD_KINDS)}")
        kind = FIELD_KINDS[layout.field]
        expect(layout.dtype in DTYPES, f"{layout.name}: dtype is one of {', '.join(DTYPES)}, not {layout.dtype}")
        promised = subject.entry.precision if subject.entry else ()
        expect(not promised or layout.dtype in promised, f"{layout.name} is {layout.dtype}; the registry: {promised}")
        allowed = FRAMES if layout.field == "position" else (kind.frame,)
        expect(
            layout.frame in allowed, f"{layout.name}: frame is {' or '.join(map(repr, allowed))}, not '{layout.frame}'"
        )
        if layout.field in _JOINT_FIELDS:
            expected, units = joints, tuple(kind.unit.split(" or "))
            expect(layout.group == "robot", f"{layout.name}: joints are recorded as group 'robot'")
            expect(layout.width == 1, f"{layout.name}: a joint has one number, not {layout.width}")
        else:
            expected, units = groups.get(layout.group, ()), (kind.unit,)
            expect(bool(expected), f"{layout.name}: the scene's groups are {', '.join(groups)}")
            components = (layout.components, kind.components)
            expect(
                components[0] == components[1], f"{layout.name}: components are {components[1]}, not {components[0]}"
            )
        expect(layout.unit in units, f"{layout.name}: unit is '{' or '.join(units)}', not '{layout.unit}'")
        expect(
            layout.items == expected, f"{layout.name}: items are {expected}, in the scene's order, not {layout.items}"
        )
        shape = (n_env, len(layout.items), layout.width)
        expect(array.shape == shape, f"state() gives {layout.name} as {array.shape}, not [env, item, width] = {shape}")
        expect(array.dtype == layout.dtype, f"state() gives {layout.name} as {array.dtype}, not {layout.dtype}")


def buffers_are_measured(subject: Subject) -> None:
    """Buffers have a name, a size, the way it came about, and a counter that the adapter has, if any."""
    description = subject.trajectory.description
    counters = {counter.name for counter in description.counters}
    for buffer in description.buffers:
        expect(bool(buffer.name), "a buffer has no name")
        expect(buffer.asked > 0, f"buffer {buffer.name} was given {buffer.asked} entries")
        expect(buffer.per in _PER, f"buffer {buffer.name} is per 'env' or 'all', not '{buffer.per}'")
        expect(bool(buffer.sized_by), f"buffer {buffer.name} does not say how its size came about (sized_by)")
        known = not buffer.counter or buffer.counter in counters
        expect(known, f"buffer {buffer.name}: there is no counter '{buffer.counter}', only {sorted(counters)}")


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
