"""Madrona's adapter, held to its contract by a stand-in of a user's module, whole and with one defect at a time."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import madrona_stand_in as stand_in
import numpy as np
import pytest

from gpusimbench.recorder.conformance import CHECKS, NotApplicable, Subject
from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.madrona.columns import TorchColumns
from gpusimbench.recorder.simulators.madrona.module import METHODS, REQUIRED_SETTINGS, VARIABLE, MadronaOptions
from gpusimbench.recorder.simulators.madrona.simulator import Madrona
from gpusimbench.schemas.errors import UsageError
from tests.conftest import finished
from tests.reading import verified

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
CONTRACT = (ROOT / "docs" / "madrona.md").read_text(encoding="utf-8")

Use = Callable[..., MadronaOptions]


@pytest.fixture
def use(monkeypatch: pytest.MonkeyPatch) -> Use:
    """Make a module of the stand-in, with other attributes or another SimManager, and name it."""

    def make(**attributes: Any) -> MadronaOptions:
        module = ModuleType("variant")
        kept = {name: getattr(stand_in, name) for name in ("madrona", "version", "SimManager")}
        for name, value in {**kept, **attributes}.items():
            if value is not None:
                setattr(module, name, value)
        monkeypatch.setitem(sys.modules, "variant", module)
        return MadronaOptions(module="variant")

    return make


def made(options: MadronaOptions, *, scene: str = "free-fall", n_env: int = 3, dt: float = 0.01) -> Madrona:
    """An adapter, not built."""
    return Madrona(make_scene(scene), n_env=n_env, dt=dt, seed=-1, options=options)


def manager(**methods: Any) -> dict[str, type]:
    """The stand-in's SimManager with other methods; one that is None is not there."""
    base: Any = stand_in.SimManager
    absent = {name for name, method in methods.items() if method is None}

    class Variant(base):  # type: ignore[misc]
        def __getattribute__(self, name: str) -> Any:
            if name in absent:
                raise AttributeError(name)
            return super().__getattribute__(name)

    for name, method in methods.items():
        if method is not None:
            setattr(Variant, name, method)
    return {"SimManager": Variant}


def settings(**others: Any) -> dict[str, type]:
    """The stand-in's SimManager with other settings; one that is None is not there."""

    def changed(self: Any) -> dict[str, Any]:
        found = {**stand_in.SimManager.settings(self), **others}
        return {key: value for key, value in found.items() if value is not None}

    return manager(settings=changed)


def tensors(wrap: Callable[[Any], Any], *names: str) -> dict[str, type]:
    """The stand-in's SimManager, some of whose tensors go through a function."""

    def wrapped(name: str) -> Callable[[Any], Any]:
        return lambda self: wrap(getattr(stand_in.SimManager, name)(self))

    return manager(**{name: wrapped(name) for name in names})


def starting(change: Callable[[Any], None]) -> dict[str, type]:
    """The stand-in's SimManager with another first state."""

    def init(self: Any, **arguments: Any) -> None:
        stand_in.SimManager.__init__(self, **arguments)
        change(self)

    return manager(__init__=init)


def test_falls_as_formulas_say(use: Use) -> None:
    """Fall for 0.3 s by g t^2 / 2, within what a first-order integrator is off, and come to rest on the ground."""
    simulator = made(use())
    description = simulator.build()
    names = [field.name for field in description.fields]
    z = names.index("cubes/position")
    start = simulator.state()[z][..., 2].copy()
    states = simulator.states(30)
    assert [array.shape for array in states] == [(30, 3, 27, 3), (30, 3, 27, 4), (30, 3, 27, 3), (30, 3, 27, 3)]
    assert np.allclose(start - states[z][-1, ..., 2], 9.81 * 0.3**2 / 2, atol=9.81 * 0.0025 * 0.3)
    assert np.allclose(states[names.index("cubes/linear_velocity")][-1, ..., 2], -9.81 * 0.3, atol=1e-4)
    counted = simulator.evidence()
    assert counted.counts["contacts"].shape == (30, 3)
    assert not counted.counts["contacts"].any()
    simulator.step(200)
    assert np.allclose(simulator.state()[z][..., 2], 0.01, atol=1e-3)
    counted = simulator.evidence()
    assert counted.counts["contacts"].tolist() == [[27, 27, 27]]
    assert simulator.gates() == []
    simulator.close()


def test_says_what_it_is(use: Use) -> None:
    """Record module, build, settings and what the scene does not get, so that nobody takes a stand-in for Madrona."""
    options = use()
    description = made(options).build()
    assert description.version == f"stand-in 1 (numpy {np.__version__}), not Madrona"
    assert description.device == "cpu"
    assert description.options["module"] == "variant"
    assert description.options["num_substeps"] == 4
    assert description.switches["solver"] == "damped spring under each body"
    assert description.switches["module_sha256"] == ""
    used = {deviation.parameter: deviation.used for deviation in description.deviations}
    assert used["smooth wood.restitution"] == "0.3"
    assert used["contact.friction_combination"] == "none"
    assert used["contact"] == "with a ground plane alone"
    real = made(MadronaOptions(module="madrona_stand_in", num_substeps=7)).build()
    assert len(real.switches["module_sha256"]) == 64
    assert real.options["num_substeps"] == 7


def test_restitution_of_the_scene_is_no_deviation(use: Use) -> None:
    """Report no deviation where the module has the scene's restitution, for all contacts or for each."""
    for value in ("scene", 0.4):
        description = made(use(**settings(restitution=value))).build()
        assert not [d for d in description.deviations if "restitution" in d.parameter]


MISSING = {name: (manager(**{name: None}), name, rf"SimManager has no {name}\(\)") for name in METHODS}

DEFECTS: dict[str, tuple[dict[str, Any], str, str]] = {
    **MISSING,
    "no SimManager": ({"SimManager": None}, "SimManager", "has no SimManager"),
    "no version": ({"version": None}, "version", "has no version"),
    "an empty version": ({"version": lambda: " "}, "version", "not a text that names the build"),
    "no ExecMode": ({"madrona": SimpleNamespace()}, "ExecMode", "has no madrona.ExecMode.CPU"),
    "another constructor": (
        manager(__init__=lambda self, exec_mode, num_worlds: None), "SimManager", "does not take its arguments",
    ),
    "scenes that are no dictionary": ({"SCENES": ["free-fall"]}, "SCENES", "not a dictionary"),
    "a scene of old": ({"SCENES": {"free-fall": "00"}}, "SCENES", "built for another 'free-fall': its SHA-256 is 00"),
    "fewer names": (manager(body_names=lambda self: ["cube"]), "body_names", r"gives 1 names; 27 bodies move"),
    "names in another order": (
        manager(body_names=lambda self: stand_in.SimManager.body_names(self)[::-1]),
        "body_names", "has 'cube_2_2_2' in row 0, where the scene has 'cube_0_0_0'",
    ),
    "settings that are none": (manager(settings=lambda self: "XPBD"), "settings", "gives str, not a dictionary"),
    **{
        f"no {key}": (settings(**{key: None}), "settings", rf"settings\(\) lacks {key}") for key in REQUIRED_SETTINGS
    },
    "settings that are no JSON": (settings(hull_margin=float("nan")), "settings", "cannot be recorded as JSON"),
    "another step": (settings(delta_t=0.04), "settings", "delta_t is 0.04; 0.01 was asked for"),
    "a step in words": (settings(delta_t="short"), "settings", "delta_t is 'short'"),
    "another gravity": (settings(gravity=[0, 0, -9.8]), "settings", r"gravity is \[0, 0, -9.8\]; the scene's is"),
    "gravity along no axis": (settings(gravity=9.81), "settings", "gravity is 9.81"),
    "no substep": (settings(num_substeps=0), "settings", "num_substeps is 0; one or more was asked for"),
    "deviations in words": (
        manager(deviations=lambda self: ["no friction"]), "deviations", r"not \(parameter, wanted, used, reason\)",
    ),
    "a flat tensor": (
        manager(position_tensor=lambda self: self._position.reshape(-1, 3)),
        "position_tensor", r"is float32 of shape \[81, 3\], not float32 of shape \[3, 27, 3\]",
    ),
    "double precision": (
        manager(rotation_tensor=lambda self: self._rotation.astype(np.float64)),
        "rotation_tensor", "is float64 of shape",
    ),
    "linear velocity alone": (
        manager(velocity_tensor=lambda self: self._velocity[..., :3]), "velocity_tensor", r"not .*\[3, 27, 6\]",
    ),
    "counts of all worlds": (
        manager(contact_count_tensor=lambda self: np.zeros(1, np.int32)), "contact_count_tensor", r"not .*\[3\]",
    ),
    "drops in floats": (
        manager(dropped_count_tensor=lambda self: np.zeros(3, np.float32)), "dropped_count_tensor", "not int32",
    ),
    "a list": (
        manager(position_tensor=lambda self: self._position.tolist()),
        "position_tensor", r"offers neither __dlpack__ nor to_torch\(\)",
    ),
    "memory that is elsewhere": (
        manager(position_tensor=lambda self: Elsewhere(self._position)),
        "position_tensor", "cannot be read as host memory by DLPack",
    ),
    "not a number": (
        starting(lambda self: self._position.__setitem__((1, 2, 0), np.nan)),
        "first state", "position of cube_0_0_2 in world 1 is not finite",
    ),
    "a constructor that steps": (starting(lambda self: self.step()), "first state", "position of cube_0_0_0 in"),
    "another place": (
        starting(lambda self: self._position.__iadd__(np.float32(1e-4))), "first state", "position of cube_0_0_0",
    ),
    "one world apart": (
        starting(lambda self: self._position.__setitem__((2, 26), 0)), "first state", "of cube_2_2_2 in world 2",
    ),
    "quaternions xyzw": (
        starting(lambda self: self._rotation.__setitem__(..., np.roll(self._rotation, -1, axis=-1))),
        "first state", "orientation of cube_0_0_0",
    ),
    "a thrown cube": (
        starting(lambda self: self._velocity.__setitem__((0, 0, 5), 1)), "first state", "angular_velocity of cube_0",
    ),
}  # fmt: skip


class Elsewhere:
    """An array that says it is on a GPU."""

    def __init__(self, array: Any) -> None:
        self._array = array

    def __dlpack__(self, **arguments: Any) -> Any:
        raise BufferError("cannot export to the host")

    def __dlpack_device__(self) -> tuple[int, int]:
        return 2, 0


@pytest.mark.parametrize("defect", DEFECTS)
def test_a_broken_promise_is_named(use: Use, defect: str) -> None:
    """Refuse the module, say what is wrong, and name an obligation that the document has."""
    attributes, obligation, message = DEFECTS[defect]
    with pytest.raises(UsageError, match=message) as caught:
        made(use(**attributes)).build()
    assert str(caught.value).startswith("madrona module 'variant': ")
    assert str(caught.value).endswith(f"(obligation '{obligation}' in docs/madrona.md)")
    assert f"| `{obligation}` |" in CONTRACT, "the document has no such obligation"


def test_every_obligation_has_a_defect() -> None:
    """Break each obligation of the document's table that can be seen before the first step, and no other."""
    documented = set(re.findall(r"^\| `([^`]+)` \|", CONTRACT, re.MULTILINE))
    seen_later = {"step", "module"}
    assert {obligation for _, obligation, _ in DEFECTS.values()} | seen_later == documented


def test_no_module(monkeypatch: pytest.MonkeyPatch) -> None:
    """Say how to name a module; take the option before the environment's."""
    monkeypatch.delenv(VARIABLE, raising=False)
    with pytest.raises(UsageError, match=r"of your own build \(docs/madrona.md\): name it with --option module=NAME"):
        made(MadronaOptions()).build()
    monkeypatch.setenv(VARIABLE, "no_such_module")
    with pytest.raises(UsageError, match="cannot be imported: No module named 'no_such_module'; is its folder"):
        made(MadronaOptions()).build()
    assert made(MadronaOptions(module="madrona_stand_in")).build().options["module"] == "madrona_stand_in"


@pytest.mark.parametrize("options", [{"device": "gpu"}, {"device": "cuda:"}, {"device": "cpu:0"}, {"num_substeps": -1}])
def test_options_that_cannot_be(options: dict[str, Any]) -> None:
    """Refuse them before anything is imported."""
    with pytest.raises(ValueError, match=next(iter(options))):
        MadronaOptions(**options)
    assert MadronaOptions(device="cuda:3").gpu == 3


def test_scenes_that_a_module_has(use: Use) -> None:
    """Take a scene that the module was built for, and no other."""
    scene = make_scene("free-fall")
    options = use(SCENES={"free-fall": scene.sha256()})
    assert made(options).build().fields
    with pytest.raises(UsageError, match="was not built for scene 'inclined-collision'; it was for: free-fall"):
        made(options, scene="inclined-collision").build()


def test_a_refusal_is_an_outcome(use: Use) -> None:
    """Record the module's own words where it does not take a scene; let what the machine lacks be what it is."""

    def refuse(self: Any, **arguments: Any) -> None:
        raise ValueError("there are\nno hulls")

    def exhausted(self: Any, **arguments: Any) -> None:
        raise ValueError("CUDA out of memory")

    with pytest.raises(Refused, match="madrona module 'variant' refuses scene 'free-fall': there are no hulls"):
        made(use(**manager(__init__=refuse))).build()
    with pytest.raises(ValueError, match="out of memory"):
        made(use(**manager(__init__=exhausted))).build()
    fixed = settings(num_substeps=4)
    with pytest.raises(UsageError, match="num_substeps is 4; 8 was asked for"):
        use(**fixed)
        made(MadronaOptions(module="variant", num_substeps=8)).build()


@pytest.mark.parametrize(
    "broken",
    [
        manager(step=lambda self: None),
        tensors(np.copy, "position_tensor", "rotation_tensor", "velocity_tensor"),
    ],
    ids=["does nothing", "tensors are copies"],
)
def test_steps_that_show_nothing(use: Use, broken: dict[str, Any]) -> None:
    """Make a run invalid where no bit of the state ever changes; not before the first step."""
    simulator = made(use(**broken))
    simulator.build()
    assert simulator.gates() == []
    simulator.step(3)
    assert "changes no bit of any state" in simulator.gates()[0]


def test_dropped_contacts(use: Use) -> None:
    """Make a run invalid where the module says that it dropped contacts, once for each time that it does."""

    def step(self: Any) -> None:
        stand_in.SimManager.step(self)
        self._dropped[1] += 2

    simulator = made(use(**manager(step=step)))
    simulator.build()
    assert simulator.gates() == []
    simulator.step(2)
    assert simulator.gates() == ["the module dropped contacts in 1 of 3 envs, first in env 1"]
    assert simulator.gates() == []


def test_without_counts(use: Use) -> None:
    """Declare no counter where the module counts nothing."""
    simulator = made(use(**manager(contact_count_tensor=None, dropped_count_tensor=None)))
    assert simulator.build().counters == ()
    simulator.states(2)
    assert simulator.evidence() is None
    assert simulator.gates() == []


class Torch:
    """A tensor as Madrona's own: to_torch and no DLPack."""

    def __init__(self, array: Any) -> None:
        self._array = array

    def to_torch(self) -> Any:
        """Share the memory."""
        import torch

        return torch.from_numpy(self._array)


TENSORS = ("position_tensor", "rotation_tensor", "velocity_tensor", "contact_count_tensor", "dropped_count_tensor")


def test_tensors_of_madrona(use: Use) -> None:
    """Read tensors that offer to_torch alone, and find the same states; say so where PyTorch is missing."""
    expected = made(use())
    expected.build()
    found = made(use(**tensors(Torch, *TENSORS)))
    try:
        import torch  # noqa: F401
    except ImportError:
        with pytest.raises(UsageError, match="need PyTorch, which is not installed: pip install torch"):
            found.build()
        return
    found.build()
    for one, other in zip(expected.states(7), found.states(7), strict=True):
        assert one.tobytes() == other.tobytes()


def test_columns_on_a_device_are_read_in_batches(use: Use, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep rows with PyTorch until the ring is full, here in host memory, and find the same states and counts."""
    pytest.importorskip("torch")
    expected = made(use())
    expected.build()
    simulator = made(use(**tensors(Torch, *TENSORS)))
    monkeypatch.setattr("gpusimbench.recorder.simulators.madrona.simulator.HostColumns", TorchColumns)
    monkeypatch.setattr("gpusimbench.recorder.simulators.madrona.columns._RING_ROWS", 4)
    description = simulator.build()
    assert description.device == "cpu"
    one, other = expected.states(10), simulator.states(10)
    for a, b in zip(one, other, strict=True):
        assert a.tobytes() == b.tobytes()
    counts = simulator.evidence()
    assert counts.counts["contacts"].shape == (10, 3)


def test_columns_on_a_gpu(use: Use) -> None:
    """Step with columns on a GPU, and find the states of the CPU."""
    torch = pytest.importorskip("torch")
    if not torch.cuda.is_available():
        pytest.skip("no GPU")

    def init(self: Any, *, exec_mode: str, gpu_id: int, **arguments: Any) -> None:
        assert exec_mode == "CUDA"
        stand_in.SimManager.__init__(self, exec_mode="CPU", gpu_id=0, **arguments)
        self.columns = {
            name: torch.from_numpy(getattr(stand_in.SimManager, name)(self)).to(f"cuda:{gpu_id}") for name in TENSORS
        }

    def step(self: Any) -> None:
        stand_in.SimManager.step(self)
        for name, column in self.columns.items():
            column.copy_(torch.from_numpy(getattr(stand_in.SimManager, name)(self)))
        torch.cuda.synchronize()

    def exported(name: str) -> Callable[[Any], Any]:
        return lambda self: self.columns[name]  # a torch.Tensor offers __dlpack__

    expected = made(use())
    expected.build()
    use(**manager(__init__=init, step=step, **{name: exported(name) for name in TENSORS}))
    simulator = made(MadronaOptions(module="variant", device="cuda"))
    assert simulator.build().device == torch.cuda.get_device_name(0)
    for one, other in zip(expected.states(60), simulator.states(60), strict=True):
        assert one.tobytes() == other.tobytes()
    assert simulator.gates() == []


KNOWN_FAILURES = {
    "stack_at_rest_stays": "no contact but with a ground plane",
    "ball_rolls_down_the_slope": "no contact but with a ground plane",
    "contacts_hold_up_the_stack": "no contact but with a ground plane",
    "contacts_change_when_a_pebble_lands": "no contact but with a ground plane",
}


PATHS = os.pathsep.join([str(ROOT), str(HERE)])
"""Where processes of their own find this project and the stand-in."""


@pytest.fixture(scope="module")
def subject() -> Iterator[Subject]:
    """The adapter over the stand-in, with the builds that all checks share."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", PATHS)
        yield Subject.named("madrona", {"module": "madrona_stand_in"})


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_conforms(subject: Subject, check: Any) -> None:
    """Pass every check but those of contacts that the stand-in does not have."""
    reason = KNOWN_FAILURES.get(check.__name__)
    try:
        check(subject)
    except NotApplicable as skipped:
        pytest.skip(str(skipped))
    except AssertionError as error:
        assert reason, str(error)
        pytest.xfail(f"{reason}: {error}")
    assert not reason, "known to fail, and it does not"


def test_a_recording_from_end_to_end(tmp_path: Path) -> None:
    """Record by the command, evaluate, and find in the file that this was no Madrona."""

    command = [
        sys.executable, "-m", "gpusimbench.recorder.cli", "--sim", "madrona", "--option", "module=madrona_stand_in",
        "--scene", "free-fall", "--n-env", "4", "--runs", "2", "--steps", "60", "--warmup", "3", "--timed-steps", "5",
        "--out", str(tmp_path / "out"),
    ]  # fmt: skip
    finished(command, env={**os.environ, "PYTHONPATH": PATHS})
    files = sorted((tmp_path / "out").glob("madrona-free-fall-n4-*.mcap"))
    assert len(files) == 2
    recording = verified(files[0])
    assert recording.status == "complete"
    assert "not Madrona" in recording.simulation.version
    assert recording.simulation.options["module"] == "madrona_stand_in"
    assert recording.state("cubes", "position").shape == (61, 4, 27, 3)
    evaluate = [
        sys.executable,
        "-m",
        "gpusimbench.evaluator.cli.eval",
        *map(str, files),
        "--sample-time",
        "0.6",
        "--json",
        "-",
    ]
    finished(evaluate, env={**os.environ, "PYTHONPATH": PATHS})


def test_a_refused_module_ends_the_run_with_its_reason(tmp_path: Path) -> None:
    """Record, of a run whose module is not there, that it was refused and why."""
    command = [
        sys.executable, "-m", "gpusimbench.recorder.cli", "--sim", "madrona", "--option", "module=no_such_module",
        "--scene", "free-fall", "--n-env", "1", "--runs", "1", "--out", str(tmp_path / "out"),
    ]  # fmt: skip
    done = finished(command, code=1, env={**os.environ, "PYTHONPATH": PATHS})
    assert "madrona module 'no_such_module': cannot be imported" in done.stderr


def test_a_changed_madrona_says_so(use: Use) -> None:
    """Take what the module says of its changes as the switch that tables look at."""
    simulator = made(use(**settings(modified="friction is multiplied")))
    assert simulator.build().switches["modified"] == "friction is multiplied"
    assert "modified" not in made(use()).build().switches
