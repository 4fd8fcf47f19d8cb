"""SAPIEN in particular: materials, environments that do not see each other, and what it must not fetch."""

from __future__ import annotations

import hashlib
import math
import os
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("sapien")

from gpusimbench.recorder.options import parse_options
from gpusimbench.recorder.scenes.base import Body, Box, Capsule, Inertial, Material, Plane, Scene, Sphere, solid_inertia
from gpusimbench.recorder.scenes.emit.usd import principal_axes
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.base import States
from gpusimbench.recorder.simulators.evidence import AWAKE_BODIES, CONTACTS
from gpusimbench.recorder.simulators.sapien import settings
from gpusimbench.recorder.simulators.sapien.bodies import make_component
from gpusimbench.recorder.simulators.sapien.complaints import OVERFLOW_BITS, Complaints, bits_of
from gpusimbench.recorder.simulators.sapien.gpu import square_grid
from gpusimbench.recorder.simulators.sapien.options import SapienOptions
from gpusimbench.recorder.simulators.sapien.simulator import Sapien
from gpusimbench.recorder.simulators.sapien.sizes import DEFAULTS, choose_sizes
from gpusimbench.schemas.errors import UsageError
from tests.conftest import run_python
from tests.rotations import rotation

G = 9.81
IMPACT = 80  # steps after which the ball has met the cubes of inclined-collision

BOUNCY = Material("bouncy", static_friction=0.5, kinetic_friction=0.5, restitution=0.8)
DULL = Material("dull", static_friction=0.5, kinetic_friction=0.5, restitution=0.4)
STICKY = Material("sticky", static_friction=0.6, kinetic_friction=0.2, restitution=0.0)


def made(scene: Scene, *, n_env: int = 1, dt: float = 0.01, determinism: str = "default", **options: object) -> Sapien:
    """A simulator that is not built yet."""
    return Sapien(scene, n_env=n_env, dt=dt, seed=0, options=SapienOptions(**options), determinism=determinism)  # type: ignore[arg-type]


def states_of(scene: Scene, n_step: int, **keywords: Any) -> States:
    """All states of a fresh build."""
    simulator = made(scene, **keywords)
    try:
        simulator.build()
        return simulator.states(n_step)
    finally:
        simulator.close()


def scene_of(*bodies: Body, gravity: tuple[float, float, float] = (0.0, 0.0, -G)) -> Scene:
    """A scene of bodies on a plane."""
    return replace(make_scene("free-fall"), bodies=bodies, gravity=gravity)


def falling_ball(height: float) -> Scene:
    """A ball of one material above a plane of another."""
    return scene_of(
        Body("ground", Plane(), DULL, position=(0.0, 0.0, 0.0)),
        Body("ball", Sphere(0.05), BOUNCY, position=(0.0, 0.0, 0.05 + height), mass=0.1, group="ball"),
    )


def rebound(height: float, **options: object) -> float:
    """Speed after the impact over speed before."""
    velocity = states_of(falling_ball(height), 600, dt=0.002, **options)[2][:, 0, 0, 2]
    landed = int(np.argmax(velocity > velocity[0] + 0.01))
    return float(velocity[landed : landed + 5].max() / -velocity[:landed].min())


def block_on_a_tilted_plane(speed: float) -> NDArray[np.floating]:
    """Downhill velocity of a block at each step, on 20 degrees, where STICKY goes on sliding but does not start."""
    angle = math.radians(20.0)
    scene = scene_of(
        Body("ground", Plane(), STICKY, position=(0.0, 0.0, 0.0)),
        Body(
            "block", Box((0.2, 0.2, 0.05)), STICKY, position=(0.0, 0.0, 0.025), mass=1.0, group="cubes",
            linear_velocity=(speed, 0.0, 0.0),
        ),
        gravity=(G * math.sin(angle), 0.0, -G * math.cos(angle)),
    )  # fmt: skip
    return states_of(scene, 100)[2][:, 0, 0, 0]


def digest(states: States, env: int = 0) -> str:
    """SHA-256 of all that an environment did."""
    return hashlib.sha256(b"".join(np.ascontiguousarray(a[:, env]).tobytes() for a in states)).hexdigest()


def test_restitution_is_the_mean_of_the_two() -> None:
    """A ball of 0.8 on a plane of 0.4 rebounds with 0.6 of its speed."""
    assert rebound(0.5) == pytest.approx(0.6, abs=0.02)


def test_small_bounces_are_stopped_below_the_threshold() -> None:
    """At 1 m/s there is no rebound with SAPIEN's own threshold of 2 m/s, and one with ours."""
    height = 1.0 / (2 * G)
    assert rebound(height, bounce_threshold=2.0) < 0.05
    assert rebound(height) == pytest.approx(0.6, abs=0.03)


def test_static_friction_holds_what_kinetic_friction_would_not() -> None:
    """tan 20 degrees lies between the two coefficients: what rests stays, what slides goes on sliding."""
    angle = math.radians(20.0)
    assert abs(block_on_a_tilted_plane(0.0)[-1]) < 1e-3
    sliding = block_on_a_tilted_plane(1.0)
    acceleration = (sliding[-1] - sliding[20]) / (79 * 0.01)
    assert acceleration == pytest.approx(G * (math.sin(angle) - 0.2 * math.cos(angle)), rel=0.02)


def test_environments_are_independent_of_their_number() -> None:
    """The only environment of one run is each of sixteen of another, bit for bit."""
    scene = make_scene("inclined-collision")
    alone = digest(states_of(scene, IMPACT))
    together = states_of(scene, IMPACT, n_env=16)
    assert {digest(together, env) for env in range(16)} == {alone}


def test_processes_agree_and_need_no_torch() -> None:
    """A fresh process makes the same bits, and imports no torch for it."""
    code = (
        "import sys\n"
        "from gpusimbench.recorder.scenes.registry import make_scene\n"
        "from tests.recorder.test_sapien import IMPACT, digest, states_of\n"
        "print(digest(states_of(make_scene('inclined-collision'), IMPACT)), 'torch' in sys.modules)\n"
    )
    root = Path(__file__).parents[2]
    said = run_python(
        code, cwd=root, env={**os.environ, "PYTHONPATH": os.pathsep.join([str(root), *filter(None, sys.path)])}
    )
    own = digest(states_of(make_scene("inclined-collision"), IMPACT))
    assert said.stdout.split() == [own, "False"]


def test_a_second_simulator_has_settings_of_its_own() -> None:
    """SAPIEN's settings are the process's; a simulator keeps those that it was built with."""
    scene = make_scene("inclined-collision")
    alone = digest(states_of(scene, IMPACT))
    first = made(scene)
    second = made(replace(scene, gravity=(0.0, 0.0, -1.0)), bounce_threshold=2.0, contact_offset=0.02)
    try:
        first.build()
        second.build()
        second.states(5)
        assert digest(first.states(IMPACT)) == alone
    finally:
        second.close()
        first.close()
    assert digest(states_of(scene, IMPACT)) == alone


@pytest.mark.parametrize("option", ["bounce_threshold=2", "contact_offset=0.02", "enable_tgs=false"])
def test_options_reach_the_engine(option: str) -> None:
    """Each changes what happens, and is told."""
    scene = make_scene("inclined-collision")
    name, value = option.split("=")
    options = parse_options("sapien", SapienOptions, {name: value})
    simulator = Sapien(scene, n_env=1, dt=0.01, seed=0, options=options)
    try:
        assert simulator.build().options[name] == getattr(options, name)
        assert digest(simulator.states(IMPACT)) != digest(states_of(scene, IMPACT))
    finally:
        simulator.close()


@pytest.mark.parametrize(
    "wrong",
    [
        {"device": "gpu"},
        {"solver_position_iterations": 256},
        {"solver_velocity_iterations": -1},
        {"bounce_threshold": 0.0},
        {"rest_offset": 0.01, "contact_offset": 0.005},
        {"sleep_threshold": math.nan},
        {"max_rigid_contact_count": -1},
    ],
)
def test_options_that_cannot_be(wrong: dict[str, Any]) -> None:
    """A value that PhysX would replace by another is refused."""
    with pytest.raises(ValueError, match=next(iter(wrong))):
        SapienOptions(**wrong)


def test_bodies_are_read_as_their_components_have_them() -> None:
    """What is read at once of a whole system are the bits that its components give one by one."""
    simulator = made(make_scene("inclined-collision"), n_env=2)
    try:
        simulator.build()
        simulator.step(60)
        position, orientation, linear, angular = simulator.state()[4:]
        for place, component in enumerate(simulator._worlds._bodies[1][1:]):  # type: ignore[attr-defined]
            assert np.array_equal(position[1, place], component.entity_pose.p)
            assert np.array_equal(orientation[1, place], component.entity_pose.q)
            assert np.array_equal(linear[1, place], component.linear_velocity)
            assert np.array_equal(angular[1, place], component.angular_velocity)
    finally:
        simulator.close()


def test_bodies_that_sleep_are_counted_out() -> None:
    """With a threshold, what rests is put to sleep; without one, nothing ever is."""
    resting = scene_of(
        Body("ground", Plane(), DULL, position=(0.0, 0.0, 0.0)),
        Body("cube", Box((0.02,) * 3), DULL, position=(0.0, 0.0, 0.01), mass=0.005, group="cubes"),
    )
    for threshold, awake in ((0.005, 0), (0.0, 1)):
        simulator = made(resting, sleep_threshold=threshold)
        try:
            told = {deviation.parameter for deviation in simulator.build().deviations}
            simulator.step(100)
            evidence = simulator.evidence()
            assert evidence.counts[AWAKE_BODIES.name].tolist() == [[awake]]
            assert evidence.counts[CONTACTS.name].tolist() == [[4]]
            assert ("bodies.at_rest" in told) == (threshold > 0)
        finally:
            simulator.close()


@pytest.mark.parametrize("shape", [Box((0.2, 0.3, 0.5)), Sphere(0.1), Capsule(0.1, 0.3)])
def test_inertia_is_that_of_a_uniform_solid(shape: Box | Sphere | Capsule) -> None:
    """The moments are those that PhysX computes from a density itself."""
    from sapien import physx

    body = Body("body", shape, DULL, position=(0.0, 0.0, 0.0), mass=1.0, group="x")
    own = physx.PhysxRigidDynamicComponent()
    own.attach(make_component(body, SapienOptions()).collision_shapes[0])
    turned = own.cmass_local_pose.to_transformation_matrix()[:3, :3]
    inertia = turned @ np.diag(own.inertia) @ turned.T / own.mass
    assert np.allclose(inertia, np.diag(solid_inertia(shape, 1.0)), rtol=1e-4, atol=1e-7)


def test_a_capsule_stands_along_z() -> None:
    """It comes to rest on a plane with its lower end, for as long as nothing tips it over."""
    standing = scene_of(
        Body("ground", Plane(), DULL, position=(0.0, 0.0, 0.0)),
        Body("capsule", Capsule(0.05, 0.2), DULL, position=(0.0, 0.0, 0.15), mass=0.1, group="x"),
    )
    assert states_of(standing, 20)[0][-1, 0, 0, 2] == pytest.approx(0.15, abs=1e-3)


def test_principal_axes_give_the_inertia_back() -> None:
    """Moments and axes make the tensor that they were taken from, right-handed."""
    for tensor in (
        (0.7, 0.71, 0.009, -1e-4, 0.007, 0.019),
        (1.0, 2.0, 3.0, 0.0, 0.0, 0.0),
        (3.0, 1.0, 2.0, 0.5, -0.2, 0.1),
    ):
        moments, axes = principal_axes(Inertial(1.0, (0.0, 0.0, 0.0), tensor))
        r = rotation(axes)
        xx, yy, zz, xy, xz, yz = tensor
        assert np.allclose(r @ np.diag(moments) @ r.T, [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def test_the_arm_follows_its_targets() -> None:
    """At rest each joint is where servo and gravity balance, within their largest torque by the stiffness."""
    scene = make_scene("franka")
    joints = scene.robot.joints()
    target = np.array([[[0.3, -0.4, 0.2, -1.5, 0.1, 1.4, 0.5]]], dtype=np.float32)
    simulator = made(scene, dt=0.002)
    try:
        description = simulator.build()
        assert [field.name for field in description.fields] == ["robot/qpos", "robot/qvel"]
        simulator.prepare(np.repeat(target, 1500, axis=0))
        qpos = simulator.states(1500)[0][:, 0, :, 0]
        assert np.array_equal(simulator.applied(), target[0])  # type: ignore[arg-type]
    finally:
        simulator.close()
    sag = np.array([joint.max_torque / joint.stiffness for joint in joints])
    assert (np.abs(qpos[-1] - target[0, 0]) < sag).all()
    assert np.abs(qpos[-1] - qpos[-100]).max() < 1e-4


@pytest.fixture
def no_downloads(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """An empty home; whatever would be fetched raises."""

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("something is downloaded")

    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr("requests.get", refuse)
    monkeypatch.setattr(settings, "find_spec", lambda _: True)  # of torch, which SAPIEN needs on a GPU alone
    return tmp_path


def test_the_library_for_gpus_is_asked_for_and_not_fetched(no_downloads: Path) -> None:
    """Without it the error says which file is missing, where it belongs, and where it is published."""
    from sapien import physx

    simulator = made(make_scene("free-fall"), device="cuda")
    with pytest.raises(UsageError) as refusal:
        simulator.build()
    simulator.close()
    path = no_downloads / ".sapien" / "physx" / physx.version() / "libPhysXGpu_64.so"
    for words in (str(path), f"releases/download/{physx.version()}/linux-", "downloads nothing"):
        assert words in str(refusal.value)
    assert not list(no_downloads.iterdir())


def test_torch_is_asked_for_on_a_gpu(no_downloads: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without torch the error says what for it is needed."""
    monkeypatch.setattr(settings, "find_spec", lambda _: None)
    with pytest.raises(UsageError, match="through torch, which is not installed"):
        settings.enable_gpu()


def test_another_physx_has_no_published_library(no_downloads: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Say for which version there is a file, and of another one that it belongs to its own build."""
    monkeypatch.setattr("sapien.physx.version", lambda: "5.8.0")
    with pytest.raises(UsageError, match=r"has PhysX 5\.8\.0, for which its makers publish none") as refusal:
        settings.check_gpu()
    assert "releases/download" not in str(refusal.value)


def test_the_release_is_known_by_its_library(tmp_path: Path) -> None:
    """What pip installed is SAPIEN; a changed byte, another PhysX and a release that nobody looked at are not."""
    import sapien
    from sapien import physx

    found = settings.library()
    assert found is not None
    digest = settings.sha256(found)
    assert settings.modification(sapien.__version__, physx.version(), digest) == ""
    changed = tmp_path / "libsapien.so"
    changed.write_bytes(found.read_bytes()[:-1] + b"?")
    other = settings.sha256(changed)
    assert re.fullmatch(
        r"libsapien\.so has SHA-256 [0-9a-f]{12}, which is not that of the released SAPIEN 3\.0\.3",
        settings.modification("3.0.3", physx.version(), other),
    )
    assert "was not found" in settings.modification("3.0.3", physx.version(), settings.sha256(tmp_path / "none.so"))
    assert settings.modification("3.0.3", "5.8.0", digest).startswith(
        "PhysX 5.8.0, where SAPIEN 3.0.3 is released with"
    )
    assert "no release known here: SAPIEN 9.9.9" in settings.modification("9.9.9", physx.version(), digest)


def test_a_build_says_which_libraries_it_has(monkeypatch: pytest.MonkeyPatch) -> None:
    """Record the hash of libsapien, and nothing of a modification unless there is one."""
    simulator = made(make_scene("free-fall"))
    try:
        switches = simulator.build().switches
    finally:
        simulator.close()
    assert switches["libsapien_sha256"] == settings.sha256(settings.library())
    assert "modified" not in switches
    monkeypatch.setattr(settings, "_LIBRARIES", {"3.0.3": frozenset({"0" * 64})})
    simulator = made(make_scene("free-fall"))
    try:
        assert simulator.build().switches["modified"].startswith("libsapien.so has SHA-256 ")
    finally:
        simulator.close()


def test_sizes_are_counted_before_the_gpu_is_on(no_downloads: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """SAPIEN warns of a system on the CPU that is made while the GPU is on."""
    order: list[str] = []

    def counted(*_: object, **__: object) -> tuple[int, int, int]:
        order.append("count")
        return 1, 1, 1

    def enabled() -> None:
        order.append("enable")
        raise UsageError("no GPU here")

    monkeypatch.setattr("gpusimbench.recorder.simulators.sapien.simulator.check_gpu", lambda: order.append("check"))
    monkeypatch.setattr("gpusimbench.recorder.simulators.sapien.sizes.measure", counted)
    monkeypatch.setattr("gpusimbench.recorder.simulators.sapien.simulator.enable_gpu", enabled)
    simulator = made(make_scene("free-fall"), device="cuda")
    with pytest.raises(UsageError, match="no GPU here"):
        simulator.build()
    simulator.close()
    assert order == ["check", "count", "enable"]


def test_the_published_address_is_sapiens_own() -> None:
    """The address is the one that SAPIEN itself would fetch from."""
    import inspect

    from sapien import physx

    assert settings._PUBLISHED in inspect.getsource(physx.enable_gpu)


def test_the_driver_is_needed_by_its_plain_name(no_downloads: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the library there and no libcuda.so, the error names that."""
    from sapien import physx

    path = settings.library_path(physx.version())
    path.parent.mkdir(parents=True)
    path.touch()

    def absent(name: str, *_: object) -> None:
        raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setattr("ctypes.CDLL", absent)
    with pytest.raises(UsageError, match=r"libcuda\.so"):
        settings.enable_gpu()


def test_buffers_are_sized_by_what_one_environment_needs() -> None:
    """Small sets keep the engine's defaults; large ones get what was counted, and options win."""
    scene = make_scene("free-fall")
    options = SapienOptions(heap_capacity=1 << 20)
    few = {b.name: b.asked for b in choose_sizes(scene, n_env=2, dt=0.01, options=options, defaults=DEFAULTS)}
    assert few == {**DEFAULTS, "heap_capacity": 1 << 20}
    many = choose_sizes(scene, n_env=1 << 14, dt=0.01, options=options, defaults=DEFAULTS)
    for buffer in many:
        assert buffer.sized_by
        assert (buffer.asked > DEFAULTS[buffer.name]) == buffer.name.startswith(("max_rigid", "found_lost"))


def test_origins_are_on_a_square_grid() -> None:
    """Neighbours are `spacing` apart, and one environment is at zero."""
    assert square_grid(1, 5.0) == ((0.0, 0.0, 0.0),)
    origins = square_grid(5, 2.0)
    assert (0.0, 0.0, 0.0) in origins
    assert len(set(origins)) == 5
    assert all(abs(x) <= 2.0 and abs(y) <= 2.0 for x, y, _ in origins)


def test_what_physx_complains_of_becomes_bits_and_gates() -> None:
    """Lines on what was dropped are fatal bits; any other critical line is a gate, once, with how often it was said."""
    complaints = Complaints()
    try:
        os.write(2, b"[SAPIEN] [critical] Contact buffer overflow detected, please increase its size to at least 9\n")
        os.write(1, b"[SAPIEN] [critical] Patch buffer overflow detected\n[SAPIEN] [info] all is well\n")
        os.write(2, b"[SAPIEN] [critical] a kernel failed\n[SAPIEN] [critical] a kernel failed\n")
        mask = complaints.take_bits()
        assert complaints.take_sentences() == ["PhysX said, 2 times: a kernel failed"]
        assert complaints.take_bits() == 0
        assert complaints.take_sentences() == []
    finally:
        complaints.close()
    assert {bit.name for bit in OVERFLOW_BITS if mask >> bit.bit & 1} == {"CONTACT_BUFFER", "PATCH_BUFFER"}
    assert all(bit.fatal for bit in OVERFLOW_BITS)
    assert bits_of("the application needs to increase foundLostPairsCapacity to 5, otherwise") == 1 << 2


def test_a_ball_that_falls_on_level_ground_keeps_to_its_line() -> None:
    """Push nothing aside: the ground is level in every bit, and the ball bounces along the vertical."""
    (position, *_) = states_of(make_scene("ball-drop"), 100)
    ball = position[:, 0, 0]
    assert np.ptp(ball[:, 2]) > 0.1
    assert np.ptp(ball[:, :2], axis=0).tolist() == [0, 0]
