"""gsb-import: what engines made of a model file: seeded defects by their names, and no false alarm."""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from gpusimbench.evaluator.imports.audit import Audit
from gpusimbench.evaluator.imports.motion import MAX_DISTANCE, Poses, Responses, poses, responses
from gpusimbench.evaluator.imports.parameters import ComparedKind, ParameterDifference, ParameterFault, compare
from gpusimbench.evaluator.imports.sections import import_document
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.markdown import render_markdown
from gpusimbench.recorder.run.import_phase import tried
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.model import ModelScene, compiled, model_scene
from gpusimbench.recorder.simulators.base import Simulator
from gpusimbench.recorder.simulators.mujoco import trials
from gpusimbench.recorder.simulators.mujoco.imported import of_c
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas.imported import Imported, Trials
from gpusimbench.schemas.model_files import pack
from tests.conftest import call, made_once

WALKER = Path(__file__).parents[2] / "examples" / "walker" / "walker.xml"

MODEL = """\
<mujoco model="arm">
  <compiler angle="degree"/>
  <option timestep="0.002" gravity="0 0 -9.81" density="1.2"/>
  <worldbody>
    <geom name="floor" type="plane" size="3 3 0.1" pos="0 0 -2"/>
    <body name="base" pos="0 0 0.5">
      <inertial pos="0 0 0" mass="2" diaginertia="0.02 0.03 0.04"/>
      <joint name="pan" axis="0 0 1" range="-90 90" damping="0.2" armature="0.01" frictionloss="0.05"/>
      <geom name="hub" type="sphere" size="0.05" friction="0.8 0.005 0.0001"/>
      <body name="upper" pos="0.1 0 0">
        <inertial pos="0 0 -0.15" mass="1" diaginertia="0.01 0.011 0.002" euler="10 20 30"/>
        <joint name="lift" axis="0 1 0" pos="0 0.01 0" range="-60 100" stiffness="2" springref="10"/>
        <geom name="arm" type="capsule" fromto="0 0 -0.05 0 0 -0.25" size="0.02"/>
        <body name="lower" pos="0 0 -0.3">
          <inertial pos="0 0 -0.1" mass="0.5" diaginertia="0.004 0.004 0.001"/>
          <joint name="elbow" axis="0 1 0" range="-120 120"/>
          <joint name="twist" axis="0 0 1" range="-45 45"/>
          <geom name="forearm" type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02"/>
        </body>
      </body>
    </body>
    <body name="slider" pos="1 0 0.3">
      <inertial pos="0 0 0" mass="0.7" diaginertia="0.001 0.001 0.001"/>
      <joint name="slide" type="slide" axis="1 0 0" range="-0.3 0.3" damping="3"/>
      <geom name="block" type="box" size="0.04 0.05 0.06"/>
    </body>
    <body name="follower" pos="1 0.5 0.3">
      <inertial pos="0 0 0" mass="0.6" diaginertia="0.001 0.001 0.001"/>
      <joint name="follow" type="slide" axis="1 0 0" range="-0.3 0.3" damping="1"/>
      <geom name="cart" type="box" size="0.04 0.05 0.06"/>
    </body>
  </worldbody>
  <contact>
    <exclude name="neighbours" body1="base" body2="lower"/>
    <pair name="meeting" geom1="block" geom2="cart" friction="0.5 0.5 0.005 0.0001 0.0001"/>
  </contact>
  <tendon>
    <fixed name="pair" stiffness="1" damping="0.1"><joint joint="pan" coef="1"/><joint joint="lift" coef="0.5"/></fixed>
  </tendon>
  <equality>
    <joint name="coupled" joint1="slide" joint2="follow" polycoef="0 1 0 0 0"/>
  </equality>
  <actuator>
    <motor name="push" joint="slide" gear="3" ctrlrange="-1 1"/>
    <position name="servo" joint="lift" kp="20" kv="1" ctrlrange="-0.5 0.5" forcerange="-30 30"/>
    <velocity name="spin" joint="pan" kv="0.5" ctrlrange="-2 2"/>
  </actuator>
</mujoco>
"""


@dataclass(frozen=True)
class Defect:
    """What one engine's copy of the model has otherwise, and the finding that has to name it."""

    name: str
    text: str
    instead: str
    kind: str
    item: str
    parameter: str = ""
    verdict: ParameterFault = ParameterFault.DIFFERS


DEFECTS = (
    Defect("mass", 'mass="0.5"', 'mass="0.51"', "bodies", "lower", "mass"),
    Defect("inertia", "0.01 0.011 0.002", "0.01 0.0111 0.002", "bodies", "upper", "inertia"),
    Defect("inertial axes", 'euler="10 20 30"', 'euler="10 20 33"', "bodies", "upper", "inertia"),
    Defect("centre of mass", 'pos="0 0 -0.1"', 'pos="0 0.001 -0.1"', "bodies", "lower", "centre_of_mass"),
    Defect("axis sign", '"elbow" axis="0 1 0"', '"elbow" axis="0 -1 0"', "joints", "elbow", "axis"),
    Defect("axis", '"elbow" axis="0 1 0"', '"elbow" axis="0.02 1 0"', "joints", "elbow", "axis"),
    Defect("anchor", 'pos="0 0.01 0"', 'pos="0 0.012 0"', "joints", "lift", "anchor"),
    Defect("body offset", '"lower" pos="0 0 -0.3"', '"lower" pos="0 0 -0.301"', "bodies", "lower", "position"),
    Defect("limit", 'range="-60 100"', 'range="-60 99"', "joints", "lift", "range"),
    Defect("limit dropped", ' range="-45 45"', ' limited="false"', "joints", "twist", "range"),
    Defect("unit", 'compiler angle="degree"', 'compiler angle="radian"', "joints", "lift", "range"),
    Defect("damping", 'damping="3"', 'damping="2.9"', "joints", "slide", "damping"),
    Defect("armature", ' armature="0.01"', "", "joints", "pan", "armature"),
    Defect("stiffness", 'stiffness="2"', 'stiffness="2.1"', "joints", "lift", "stiffness"),
    Defect("spring reference", 'springref="10"', 'springref="0"', "joints", "lift", "spring_reference"),
    Defect("frictionloss", ' frictionloss="0.05"', "", "joints", "pan", "frictionloss"),
    Defect("friction", 'friction="0.8 0.005 0.0001"', "", "geoms", "hub", "friction"),
    Defect("gain", 'kp="20"', 'kp="21"', "actuators", "servo", "gain"),
    Defect("velocity gain", 'kv="1"', "", "actuators", "servo", "bias"),
    Defect("gear", 'gear="3"', 'gear="-3"', "actuators", "push", "gear"),
    Defect("force range", ' forcerange="-30 30"', "", "actuators", "servo", "force_range"),
    Defect("control range", 'ctrlrange="-2 2"', 'ctrlrange="-1 1"', "actuators", "spin", "control_range"),
    Defect("actuator missing", '<velocity name="spin" joint="pan" kv="0.5" ctrlrange="-2 2"/>', "", "actuators", "spin",
           verdict=ParameterFault.MISSING),
    Defect("actuator on another joint", 'joint="pan" kv', 'joint="elbow" kv', "actuators", "spin", "target"),
    Defect("equality dropped", '<joint name="coupled" joint1="slide" joint2="follow" polycoef="0 1 0 0 0"/>', "",
           "equalities", "coupled", verdict=ParameterFault.MISSING),
    Defect("equality's ratio", 'polycoef="0 1 0 0 0"', 'polycoef="0 1.1 0 0 0"', "equalities", "coupled", "data"),
    Defect("exclude dropped", '<exclude name="neighbours" body1="base" body2="lower"/>', "", "excludes", "base - lower",
           verdict=ParameterFault.MISSING),
    Defect("pair's friction", 'friction="0.5 0.5', 'friction="0.6 0.6', "pairs", "block - cart", "friction"),
    Defect("tendon's ratio", 'coef="0.5"', 'coef="-0.5"', "tendons", "pair", "path"),
    Defect("tendon's stiffness", 'name="pair" stiffness="1"', 'name="pair"', "tendons", "pair", "stiffness"),
    Defect("gravity", 'gravity="0 0 -9.81"', 'gravity="0 0 -9.8"', "model", "model", "gravity"),
    Defect("time step", 'timestep="0.002"', 'timestep="0.0025"', "model", "model", "timestep"),
    Defect("density of the air", ' density="1.2"', "", "model", "model", "density"),
)  # fmt: skip


def _order(text: str, *parts: str) -> str:
    first, second = parts
    assert first in text and second in text
    return text.replace(first, "@").replace(second, first).replace("@", second)


_ACTUATORS = ('<motor name="push" joint="slide" gear="3" ctrlrange="-1 1"/>',
              '<velocity name="spin" joint="pan" kv="0.5" ctrlrange="-2 2"/>')  # fmt: skip
_JOINTS = ('<joint name="elbow" axis="0 1 0" range="-120 120"/>', '<joint name="twist" axis="0 0 1" range="-45 45"/>')


@dataclass(frozen=True)
class Held:
    """What an engine made of a model, and did with it."""

    scene: ModelScene
    imported: Imported
    trials: Trials


def _held(path: Path, engine: str = "mujoco", given: dict[str, str] | None = None) -> Held:
    scene = model_scene(path.stem, pack(path), actions="none")
    adapter = find_simulator(engine).load()
    if given is None:
        given = {"solver": "Newton"} if engine == "warp" and scene.solver["solver"] == "PGS" else {}
    options = adapter.parsed(engine, scene, given)

    def make(of: Scene, n_env: int) -> Simulator:
        return adapter(of, n_env=n_env, dt=scene.dt, seed=0, options=options)

    simulator = make(scene, 1)
    simulator.build()
    imported = simulator.imported()
    simulator.close()
    trials = tried(scene, make, dt=scene.dt, seed=0)
    assert imported is not None and trials is not None
    return Held(scene, Imported.decoded(imported.encoded()), Trials.decoded(trials.encoded()))


def _items(held: Held) -> dict[str, tuple[str, ...]]:
    scene, joints = held.scene, tuple(joint.name for joint in held.scene.joints)
    free = dict.fromkeys(("position", "orientation", "linear_velocity", "angular_velocity"), scene.free_bodies)
    balls = dict.fromkeys(("orientation", "angular_velocity"), scene.balls)
    return {
        **{f"bodies/{name}": items for name, items in free.items()},
        **{f"joints/{name}": joints for name in ("qpos", "qvel")},
        **{f"balls/{name}": items for name, items in balls.items()},
    }


def _moved(reference: Held, engine: Held) -> tuple[Poses, Responses]:
    items = _items(reference), _items(engine)
    found = poses(reference.trials, engine.trials, items), responses(reference.trials, engine.trials, items)
    assert isinstance(found[0], Poses) and isinstance(found[1], Responses)
    return found[0], found[1]


def _findings(found: tuple[ComparedKind, ...]) -> list[ParameterDifference]:
    return [finding for kind in found for finding in kind.findings]


def _write(folder: Path, text: str, name: str = "arm.xml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Held:
    """The arm on MuJoCo C."""
    return _held(_write(tmp_path_factory.mktemp("arm"), MODEL))


@pytest.mark.parametrize("defect", DEFECTS, ids=lambda defect: defect.name)
@pytest.mark.parametrize("engine", ["mujoco", pytest.param("warp", marks=pytest.mark.slow)])
def test_a_seeded_defect(defect: Defect, engine: str, reference: Held, tmp_path: Path) -> None:
    """Name what differs in the copy of the model that one engine alone is given, and no other parameter of it."""
    assert MODEL.count(defect.text) == 1
    broken = _held(_write(tmp_path, MODEL.replace(defect.text, defect.instead)), engine)
    found = _findings(compare(reference.imported, broken.imported))
    named = {(finding.verdict, finding.kind, finding.item, finding.parameter) for finding in found}
    wanted = (defect.verdict, defect.kind, defect.item, defect.parameter)
    assert wanted in named
    also = {finding.parameter for finding in found} - {defect.parameter}
    assert also <= _FOLLOWING.get(defect.name, set())


_FOLLOWING = {
    "spring reference": {"spring_length"},  # of the tendon over this joint
    "tendon's ratio": {"spring_length"},
    "gain": {"bias"},  # a servo's kp is both
    "unit": {"spring_reference", "spring_length", "inertia"},  # and all that follows from degrees
}


@pytest.mark.parametrize(("kind", "parts"), [("actuators", _ACTUATORS), ("joints", _JOINTS)])
def test_another_order(kind: str, parts: tuple[str, str], reference: Held, tmp_path: Path) -> None:
    """Name the kind whose things stand in another order; what each of them is does not differ."""
    broken = _held(_write(tmp_path, _order(MODEL, *parts)))
    (found,) = _findings(compare(reference.imported, broken.imported))
    assert (found.verdict, found.kind) == (ParameterFault.ORDER, kind)
    if kind == "joints":  # of one body: its pose depends on their order
        assert [link.link for link in _moved(reference, broken)[0].wrong] == ["lower"]


@pytest.mark.parametrize("engine", ["mujoco", pytest.param("warp", marks=pytest.mark.slow)])
def test_no_false_alarm(engine: str, reference: Held, tmp_path: Path) -> None:
    """Find nothing where an engine was given the same model, and compare all of it."""
    held = _held(_write(tmp_path, MODEL), engine)
    found = compare(reference.imported, held.imported)
    assert not _findings(found) and not any(kind.not_compared for kind in found)
    assert [(kind.kind, kind.things) for kind in found] == [
        ("model", 1), ("bodies", 6), ("joints", 6), ("geoms", 6), ("pairs", 1), ("excludes", 1), ("tendons", 1),
        ("equalities", 1), ("actuators", 3),
    ]  # fmt: skip
    placed, responded = _moved(reference, held)
    assert len(placed.links) == 6 and not placed.wrong
    assert len(responded.each) == 9 and not responded.wrong
    assert all(one.agrees for one in responded.each)


@pytest.mark.parametrize(
    ("text", "instead", "links", "targets"),
    [
        ('pos="0 0.01 0"', 'pos="0.01 0.01 0"', {"upper", "lower"}, {"lift"}),
        ('mass="0.7"', 'mass="1"', set(), {"slide", "push"}),
        ('gear="3"', 'gear="4"', set(), {"push"}),
        ('kv="0.5"', 'kv="1"', set(), {"spin"}),
    ],
)
def test_what_it_does(
    text: str, instead: str, links: set[str], targets: set[str], reference: Held, tmp_path: Path
) -> None:
    """See in the motion, too, what differs: the links that are elsewhere, the joints and actuators that respond in
    another way."""
    broken = _held(_write(tmp_path, MODEL.replace(text, instead)))
    placed, responded = _moved(reference, broken)
    assert {link.link for link in placed.wrong} == links
    assert targets <= {one.target for one in responded.wrong}
    assert all(link.distance > MAX_DISTANCE for link in placed.wrong)


def _models() -> list[Path]:
    found = find_spec("gymnasium")
    assets = Path(str(found.origin)).parent / "envs" / "mujoco" / "assets" if found else Path("nowhere")
    return [WALKER, *sorted(assets.glob("*.xml"))]


@pytest.mark.slow
@pytest.mark.parametrize("path", _models(), ids=lambda path: path.stem)
def test_no_false_alarm_on_real_models(path: Path) -> None:
    """Find nothing between MuJoCo C and MuJoCo Warp on the walker and Gymnasium's models."""
    ours, theirs = _held(path), _held(path, "warp")
    assert not _findings(compare(ours.imported, theirs.imported))
    placed, responded = _moved(ours, theirs)
    assert not placed.wrong and not responded.wrong
    assert any(one.agrees for one in responded.each) or path.stem.startswith("pusher")  # whose bodies always touch


def test_the_smallest_model(tmp_path: Path) -> None:
    """Hold and try a model with a joint and nothing else."""
    text = '<mujoco><worldbody><body><joint/><geom size=".1"/></body></worldbody></mujoco>'
    held = _held(_write(tmp_path, text))
    assert held.imported.names["joints"] == ("body1/joint0",) and not held.imported.names["actuators"]
    assert not _findings(compare(held.imported, held.imported))
    placed, responded = _moved(held, held)
    assert [link.link for link in placed.links] == ["world", "body1"] and len(responded.each) == 1


def test_an_actuator_of_several_controls(tmp_path: Path) -> None:
    """Hold the ranges of an actuator's controls in its row, and try each of its controls by itself."""
    path = tmp_path / "several.xml"
    path.write_text(
        '<mujoco><worldbody><body><joint name="j"/><geom size=".1"/></body></worldbody><actuator>'
        '<motor name="push" joint="j" ctrlrange="-2 2"/><dcmotor name="servo" joint="j" motorconst="1" resistance="1" '
        'input="pos vel" controller="10 0 5"/></actuator></mujoco>'
    )
    scene = model_scene("several", pack(path))
    held = of_c(compiled(scene.archive)[1])
    inf = np.inf
    ranges = held.values["actuators/control_range"]
    np.testing.assert_array_equal(ranges, [[-2, 2, np.nan, np.nan], [-inf, inf, -inf, inf]])
    plan = trials.plan(scene, dt=0.002, seed=0)
    assert plan.targets[-3:] == ("push", "servo.0", "servo.1")
    assert (plan.controls[-3:] != 0).tolist() == np.eye(3, dtype=bool).tolist()


def test_what_an_engine_does_not_have(reference: Held) -> None:
    """Say what is lost where an engine knows no such parameter and the model uses it, and nothing where it does not."""
    held = reference.imported
    values = {k: v for k, v in held.values.items() if k not in ("joints/frictionloss", "geoms/gap", "geoms/solmix")}
    engine = Imported(held.names, values, {"joints/frictionloss": "the engine has no dry friction in joints"})
    found = compare(held, engine)
    (lost,) = _findings(found)
    assert (lost.verdict, lost.kind, lost.parameter, lost.item) == (
        ParameterFault.LOST,
        "joints",
        "frictionloss",
        "1 of 6",
    )
    assert lost.found == "the engine has no dry friction in joints"
    assert [kind.not_compared for kind in found if kind.not_compared] == [
        (("solmix", "the engine's value is not read"),)
    ]
    without = Imported({**held.names, "tendons": ()}, held.values, {"tendons": "no tendons"})
    (missing,) = _findings(compare(held, without))
    assert (missing.verdict, missing.item, missing.found) == (ParameterFault.MISSING, "pair", "no tendons")
    not_read = Imported({k: v for k, v in held.names.items() if k != "tendons"}, held.values, {"tendons": "not read"})
    found = compare(held, not_read)
    assert not _findings(found)
    assert [kind.not_compared for kind in found if kind.not_compared] == [(("all of them", "not read"),)]


def test_shapes_that_are_only_shown(tmp_path: Path) -> None:
    """Take a shape that collides with nothing for no loss where it is not there, and any other for one."""
    shown = MODEL.replace('name="arm"', 'name="arm" contype="0" conaffinity="0"')
    held = _held(_write(tmp_path, shown)).imported
    for name, verdicts in (("arm", []), ("forearm", [ParameterFault.MISSING])):
        kept = [i for i, geom in enumerate(held.names["geoms"]) if geom != name]
        names = {**held.names, "geoms": tuple(held.names["geoms"][i] for i in kept)}
        values = {key: rows[kept] if key.startswith("geoms/") else rows for key, rows in held.values.items()}
        found = compare(held, Imported(names, values))
        assert [finding.verdict for finding in _findings(found)] == verdicts
        assert sum(bool(kind.not_compared) for kind in found) == (not verdicts)


def test_signs_of_orientations(reference: Held) -> None:
    """Take both signs of a quaternion for the same orientation, and a NaN for none."""
    held = reference.imported
    turned = {**held.values, "bodies/orientation": -np.asarray(held.values["bodies/orientation"], dtype=float)}
    assert not _findings(compare(held, Imported(held.names, turned)))
    none = {**held.values, "bodies/mass": np.full_like(held.values["bodies/mass"], np.nan)}
    assert {f.parameter for f in _findings(compare(held, Imported(held.names, none)))} == {"mass"}


def test_what_a_stranger_may_write(reference: Held) -> None:
    """Say what cannot be compared where rows and trials are of other widths than ours, and raise nothing."""
    held, trials, items = reference.imported, reference.trials, (_items(reference), _items(reference))
    narrow = {**held.values, "bodies/orientation": np.zeros((6, 2)), "joints/axis": np.full((6, 1), np.inf)}
    found = _findings(compare(held, Imported(held.names, narrow)))
    assert {finding.parameter for finding in found} == {"orientation", "axis"}
    assert _findings(compare(Imported(held.names, narrow), held))
    wide = {name: np.concatenate([array, array], axis=-1) for name, array in trials.velocity.items()}
    found_responses = responses(trials, Trials(**{**vars(trials), "velocity": wide}), items)
    assert isinstance(found_responses, Responses) and all(one.agrees is None for one in found_responses.each)
    empty = Trials(
        **{**vars(trials), "given": {}, "position": trials.position[:3], "orientation": trials.orientation[:3]}
    )
    assert isinstance(poses(empty, Trials(**{**vars(trials), "given": {}}), items), Missing)
    assert isinstance(poses(trials, empty, items), Missing)
    nothing = {name: np.full_like(array, np.nan) for name, array in trials.velocity.items()}
    found_responses = responses(trials, Trials(**{**vars(trials), "velocity": nothing}), items)
    assert isinstance(found_responses, Responses) and len(found_responses.wrong) == 9
    audit = Audit(
        "stranger", "1", "cpu", (), "arm.xml", same_file=True, file=None, missing="", kinds=(),
        responses=found_responses, poses=Missing("not tried"), landings=Missing("not tried"),
    )  # fmt: skip
    said = render_markdown(import_document([audit], every=True))
    assert "not finite" in said
    assert "inf time steps" not in said


@pytest.mark.slow
def test_newton(reference: Held, tmp_path: Path) -> None:
    """Find nothing in what Newton's own importer made for its solver mujoco, and what solver xpbd has nothing for."""
    path = _write(tmp_path, MODEL)
    held = _held(path, "newton")
    found = compare(reference.imported, held.imported)
    assert not _findings(found)
    assert {name for kind in found for name, _ in kind.not_compared} == {"contype", "conaffinity"}
    placed, responded = _moved(reference, held)
    assert not placed.wrong and not responded.wrong and all(one.agrees for one in responded.each)
    xpbd = _held(path, "newton", {"solver": "xpbd"})
    named = {(f.verdict, f.kind, f.item, f.parameter) for f in _findings(compare(reference.imported, xpbd.imported))}
    assert named >= {
        (ParameterFault.MISSING, "tendons", "pair", ""),
        (ParameterFault.MISSING, "equalities", "coupled", ""),
        (ParameterFault.DIFFERS, "joints", "pan", "armature"),
        (ParameterFault.DIFFERS, "joints", "pan", "frictionloss"),
        (ParameterFault.DIFFERS, "joints", "slide", "damping"),
        (ParameterFault.DIFFERS, "joints", "lift", "stiffness"),
    }
    placed, responded = _moved(reference, xpbd)
    assert not placed.wrong and responded.wrong


def _import(folder: Path) -> None:
    done = call("gsb-import", WALKER, "--sim", "warp", "--out", folder / "out", "--json", folder / "result.json")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "agrees with MuJoCo C" in done.stdout


def of_walker() -> Path:
    """The walker on MuJoCo C and MuJoCo Warp, compared; must not be written to."""
    return made_once("import-of-walker", _import)


@pytest.fixture(scope="module")
def recorded_folder() -> Path:
    """The same."""
    return of_walker()


@pytest.mark.slow
def test_the_command(recorded_folder: Path) -> None:
    """Record and compare an engine; compare again what was recorded; say it in JSON, too."""
    made = sorted((recorded_folder / "out").glob("*.mcap"))
    assert [path.name.split("-")[0] for path in made] == ["mujoco", "warp"]
    again = call("gsb-import", recorded_folder / "out", "--json", "-", code=0)
    (engine,) = json.loads(again.stdout)["engines"]
    assert engine == json.loads((recorded_folder / "result.json").read_text())["engines"][0]
    assert (engine["simulator"], engine["agrees"], engine["poses"]["n_pose"]) == ("warp", True, 16)
    for command in ("gsb-check", "gsb-info", "gsb-eval"):
        call(command, *made, code=0)


@pytest.mark.slow
def test_what_cannot_be_compared(recorded_folder: Path, tmp_path: Path) -> None:
    """Say what is missing: a reference, an engine, a name of one; refuse phases that a scene does not have."""
    made = sorted((recorded_folder / "out").glob("*.mcap"))
    for arguments, code, said in (
        (made[:1], 5, "hold no model file on another simulator"),
        (made[1:], 5, "no recording of MuJoCo C"),
        ([WALKER], 2, "name the engines"),
        ([WALKER, "--sim", "mujoco"], 2, "names engines to be compared"),
        ([WALKER, "--sim", "no-such-engine"], 2, "no-such-engine"),
        ([WALKER, WALKER, "--sim", "warp"], 2, "one model file"),
        ([*made, "--option", "solver=CG"], 2, "recordings were made with theirs"),
        ([tmp_path / "gone.xml", "--sim", "warp", "--out", tmp_path], 2, "gone.xml"),
    ):
        done = call("gsb-import", *arguments, code=code)
        assert said in done.stderr, (arguments, done.stderr)
    refused = call("gsb-import", WALKER, "--sim", "calibration", "--out", tmp_path / "out", code=4)
    assert "has no model files" in " ".join(refused.stdout.split())
    done = call("gsb-record", "--sim", "mujoco", "--phases", "import", "--out", tmp_path)
    assert done.returncode == 2 and "--phases import is of a model file" in done.stderr


def test_where_trials_begin(tmp_path: Path) -> None:
    """Begin trials in the middle of all limits, where no limit acts on what is tried."""
    path = _write(
        tmp_path, MODEL.replace('range="-60 100"', 'range="20 100"').replace('pos="1 0 0.3"', 'pos="3 0 0.3"')
    )
    started = _held(path).trials.start["joints/qpos"].ravel()
    np.testing.assert_allclose(started, np.radians([0, 60, 0, 0, 0, 0])[: len(started)], atol=1e-9)
