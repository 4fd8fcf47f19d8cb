"""The figures of gsb-eval a second time, from files and the sentences of docs/, by none of the package's code."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Sequence
from functools import cache
from itertools import combinations, pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from scipy.stats import t as student

from tests.conftest import Command, call, recorded
from tests.evaluator.test_history import write_point

Array = NDArray[np.float64]
_RECORDINGS = Path(__file__).resolve().parents[2] / "recordings"
_GRAVITY = 9.81
_STATE = ("position", "orientation", "linear_velocity", "angular_velocity")
_SET = "h100/{}-inclined-collision-n16-r[0-4]*.mcap"


class _File:
    """A recording, as any reader of MCAP with the embedded schemas has it."""

    def __init__(self, path: Path) -> None:
        blocks: dict[str, list[Any]] = defaultdict(list)
        self.messages: dict[str, list[Any]] = defaultdict(list)
        with path.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
            self.json = {a.name: json.loads(a.data) for a in reader.iter_attachments() if a.name.endswith(".json")}
            for _, channel, _, message in reader.iter_decoded_messages():
                topic = channel.topic
                (blocks if topic.startswith("/state/") else self.messages)[topic].append(message)
        self.asked, self.scene = self.json["provenance.json"]["configuration"], self.json["scene.json"]
        self.fields = self.json["simulation.json"]["fields"]
        self.dt, self.n_env = self.asked["dt"], self.asked["n_env"]
        self.raw = {}  # the engine's own numbers, [row, env, item, component]
        for field in self.fields:
            parts = blocks[f"/state/{field['group']}/{field['field']}/000000"]
            rows = [np.array(b.data64 or b.data, field["dtype"]).reshape(-1, b.envs, b.items, b.width) for b in parts]
            if rows:
                self.raw[field["group"], field["field"]] = np.concatenate(rows)
                self.steps = [b.first_step + i * b.stride for b in parts for i in range(b.steps)]

    def of(self, group: str, field: str) -> Array:
        return self.raw[group, field].astype(float)

    def windows(self) -> list[tuple[int, int]]:
        """First and last clock of each time that the timed steps were made [ns]."""
        clock = self.messages["/timing/timed"]
        begins = [i for i, m in enumerate(clock) if m.first_step == clock[0].first_step]  # each begins a window
        ends = [i - 1 for i in (*begins[1:], 0)]
        return [(clock[a].start_ns[0], clock[b].end_ns[-1]) for a, b in zip(begins, ends, strict=True)]

    @property
    def step_s(self) -> float:
        """Mean duration of a timed step [s]."""
        windows = self.windows()
        return sum(end - begin for begin, end in windows) * 1e-9 / len(windows) / self.asked["timed_steps"]

    def hashes(self) -> NDArray[np.uint64]:
        """Of the state of each environment after each step, [step, env]."""
        blocks = self.messages["/fingerprint/capture"]
        return np.concatenate([np.array(b.hashes, np.uint64).reshape(b.steps, b.envs) for b in blocks])


@cache
def _files(pattern: str) -> tuple[_File, ...]:
    return tuple(_File(path) for path in sorted(_RECORDINGS.glob(pattern)))


def _evaluated(gsb_eval: Command, *patterns: str) -> Any:
    paths = [path for pattern in patterns for path in sorted(_RECORDINGS.glob(pattern))]
    return json.loads(gsb_eval(*paths, "--json", "-", "--no-cache", code=0).stdout)


def _agrees(metric: dict[str, Any], per_run: Sequence[float], *, scale: float = 1.0) -> None:
    """Compare a mean over runs with its delete-one-run jackknife."""
    values = np.array(per_run) * scale
    assert metric["extra"]["per_run"] == pytest.approx(list(values), rel=1e-9, abs=1e-12)
    _agrees_mean(metric, values.mean(), values.std(ddof=1), [np.delete(values, r).mean() for r in range(len(values))])


def _agrees_mean(metric: dict[str, Any], mean: float, sd: float, without: Sequence[float]) -> None:
    left, n = np.array(without), len(without)
    half = student.ppf(0.975, n - 1) * np.sqrt((n - 1) / n * ((left - left.mean()) ** 2).sum())
    assert (metric["value"], metric["sd"]) == pytest.approx((mean, sd), rel=1e-9, abs=1e-12)
    assert metric["ci95"] == (pytest.approx([max(mean - half, 0.0), mean + half], rel=1e-7, abs=1e-12) if sd else None)


def test_time_and_memory(gsb_eval: Command) -> None:
    """Throughput, capture overhead and three memories, from clock readings and samples."""
    pattern = _SET.format("warp")
    metrics = _evaluated(gsb_eval, pattern)["groups"][0]["metrics"]
    fps, overhead, peaks = [], [], defaultdict(list)
    for run in _files(pattern):
        windows, step = run.windows(), run.step_s
        fps.append(run.n_env / step)
        (capture,) = run.messages["/timing/capture"]
        overhead.append((capture.end_ns[-1] - capture.start_ns[0]) * 1e-9 / run.steps[-1] / step)
        for topic in ("host", "gpu0/device", "gpu0/process"):
            samples = run.messages[f"/memory/{topic}"]
            timed = [s.used_bytes for s in samples if s.phase == "timed" and s.monotonic_ns <= windows[0][1]]
            baseline = [s.used_bytes for s in samples if s.checkpoint == "baseline"]
            peaks[topic].append(max(timed) - (0 if "process" in topic else baseline[0]))
    _agrees(metrics["fps"], fps)
    _agrees(metrics["capture_slowdown"], overhead)
    _agrees(metrics["host_memory_peak_increment"], peaks["host"], scale=1e-6)
    _agrees(metrics["memory_peak_increment"], peaks["gpu0/device"], scale=1e-9)
    _agrees(metrics["process_memory_peak"], peaks["gpu0/process"], scale=1e-9)


def _w1(a: Array, b: Array) -> float:
    cost = cdist(a, b)
    return float(cost[linear_sum_assignment(cost)].mean()) * 100.0


def _classes(members: NDArray[np.uint64]) -> list[int]:
    histories = [member.tobytes() for member in members]
    return [list(dict.fromkeys(histories)).index(history) for history in histories]


@pytest.mark.parametrize("pattern", [_SET.format("warp"), _SET.format("mjx-jax")])
def test_distances_and_bits(gsb_eval: Command, pattern: str) -> None:
    """W1 with and without clamp, bodies off the board, type, ULP, and classes of equal bits."""
    metrics = _evaluated(gsb_eval, pattern)["groups"][0]["metrics"]
    runs = _files(pattern)
    numbers = np.stack(
        [run.raw["cubes", "position"][run.steps.index(round(5.0 / run.dt))] for run in runs]
    )  # of all runs at 5 s
    positions = numbers.astype(float)
    board = next(b for b in runs[0].scene["bodies"] if b["name"] == runs[0].scene["board"])
    centre, half = np.array(board["position"]), np.array(board["shape"]["size"]) / 2
    low, high = (centre - half)[:2], (centre + half)[:2]
    free = positions[..., :2]
    off = ((free < low) | (free > high)).any(-1) | (positions[..., 2] < centre[2] + half[2])
    assert metrics["left_board"]["extra"]["per_run"] == off.sum(axis=(1, 2)).tolist()
    for name, planes in (("", free), ("_clamped", np.clip(free, low, high))):
        within = [np.mean([_w1(a, b) for a, b in combinations(p, 2)]) for p in planes]
        _agrees(metrics["w1_parallel" + name], within)
        pooled = planes.reshape(len(runs), -1, 2)
        apart = {(a, b): _w1(pooled[a], pooled[b]) for a, b in combinations(range(len(runs)), 2)}
        pairs = list(apart.values())
        left = [np.mean([d for pair, d in apart.items() if r not in pair]) for r in range(len(runs))]
        _agrees_mean(metrics["w1_run_to_run" + name], np.mean(pairs), np.std(pairs, ddof=1), left)
        if not name:
            present = round(float(np.mean(within)), 2) > 0, round(float(np.mean(pairs)), 2) > 0
            assert metrics["regime_published"]["value"] == {(1, 0): 1, (0, 0): 2, (1, 1): 3, (0, 1): 4}[present]

    hashes = np.stack([run.hashes() for run in runs])
    for own, found in zip(hashes, metrics["distinct_envs"]["extra"]["classes"], strict=True):
        assert found == _classes(own.T)
    assert metrics["distinct_runs"]["extra"]["classes"] == _classes(hashes)
    apart_at = (hashes != hashes[0]).any(axis=(0, 2))
    assert metrics["distinct_runs"]["extra"]["first_difference_step"] == (apart_at.argmax() if apart_at.any() else None)
    ulp = np.spacing(np.abs(numbers).max(axis=(0, 3)))[..., np.newaxis].astype(float)
    worst = (numbers.max(axis=0).astype(float) - numbers.min(axis=0)) / ulp
    assert metrics["equality_runs"]["extra"]["worst_ulp"] == pytest.approx(worst.max())


def _turn(quaternion: Array) -> Rotation:
    return Rotation.from_quat(quaternion[..., [1, 2, 3, 0]])  # from w, x, y, z


def test_mechanics(gsb_eval: Command) -> None:
    """Energy, displacement and penetration, from states and the geometry of the scene."""
    checks = _evaluated(gsb_eval, "mujoco-amd-r[01].mcap")["groups"][0]["physics"]["checks"]
    found = defaultdict(list)
    for run in _files("mujoco-amd-r[01].mcap"):
        kinetic, x, v, depth = 0.0, [], [], []
        for group in ("ball", "cubes"):
            body = next(b for b in run.scene["bodies"] if b["group"] == group)
            position, turn, linear, spin = (run.of(group, field) for field in _STATE)
            size = body["shape"].get("radius") or body["shape"]["size"][0]  # cubes: the same about every axis
            inertia = body["mass"] * size**2 * (2 / 5 if group == "ball" else 1 / 6)
            energy = body["mass"] * (_GRAVITY * position[..., 2] + (linear**2).sum(-1) / 2)
            kinetic = kinetic + (energy + inertia * (spin**2).sum(-1) / 2).sum(-1)
            x, v = [*x, position], [*v, linear]
            corners = position[..., np.newaxis, :]
            if group == "cubes":
                axes = _turn(turn.reshape(-1, 4)).as_matrix().transpose(0, 2, 1)
                signs = np.array(list(product((-1, 1), repeat=3))) * size / 2
                corners = corners + (signs @ axes).reshape(*position.shape[:3], 8, 3)
            for fixed in (b for b in run.scene["bodies"] if not b["group"]):
                local = (corners - fixed["position"]) @ _turn(np.array(fixed["orientation"])).as_matrix()
                beyond = np.abs(local) - np.array(fixed["shape"]["size"]) / 2
                apart = np.linalg.norm(np.maximum(beyond, 0), axis=-1) + np.minimum(beyond.max(-1), 0)
                depth.append(((size if group == "ball" else 0.0) - apart).max(axis=(0, 2, 3)))
        found["depth_ever"] += list(np.maximum(np.max(depth, axis=0), 0))
        found["energy_above_start"] += list((kinetic - kinetic[0]).max(axis=0))
        moved, speed = np.diff(np.concatenate(x, axis=2), axis=0), np.concatenate(v, axis=2)
        far = np.linalg.norm(moved - (speed[1:] + speed[:-1]) * run.dt / 2, axis=-1)
        beyond = far - np.linalg.norm(np.diff(speed, axis=0), axis=-1) * run.dt / 2
        found["displacement"] += list(np.maximum(beyond.max(axis=(0, 2)), 0))
    for name, values in found.items():
        by_hand = pytest.approx((np.mean(values), np.max(values)), rel=1e-6, abs=1e-14)
        assert (checks[name]["mean"], checks[name]["most"]) == by_hand, name


def test_tosses(gsb_eval: Command) -> None:
    """Errors against the reference, toss by toss over its own rows, and W1 to it."""
    pattern = "cube-toss/warp-cube-toss-n48-r*.mcap"
    document = _evaluated(gsb_eval, pattern, "cube-toss/real-*.mcap")
    metrics = document["groups"][0]["metrics"]
    run, (real,) = _files(pattern)[0], _files("cube-toss/real-*.mcap")
    body = next(b for b in run.scene["bodies"] if b["group"])
    mass, edge = body["mass"], body["shape"]["size"][0]
    errors = []
    for toss, rows in enumerate(real.json["tosses.json"]["rows"]):
        at = [i for i, step in enumerate(run.steps) if step < rows]
        sides = []
        for file, index in ((run, at), (real, [run.steps[i] for i in at])):
            p, q, v, w = (file.of("cubes", field)[index, toss, 0] for field in _STATE)
            energy = mass * (_GRAVITY * p[:, 2] + (v**2).sum(-1) / 2) + mass * edge**2 / 12 * (w**2).sum(-1)
            sides.append((p, _turn(q), energy))
        (p, turn, energy), (true_p, true_turn, true_energy) = sides
        apart, angle = np.linalg.norm(p - true_p, axis=-1) * 100, np.degrees((turn * true_turn.inv()).magnitude())
        up, true_up = (side[-1].as_matrix()[2] for side in (turn, true_turn))  # the vertical, seen by the cube
        face = np.abs(up).argmax()
        errors.append({
            "position": apart[1:].mean(), "end_position": apart[-1],
            "rotation": angle[1:].mean(), "end_rotation": angle[-1],
            "energy": np.abs(energy - true_energy)[1:].mean() * 1000,
            "face": 100.0 * (face == np.abs(true_up).argmax() and up[face] * true_up[face] > 0),
            "depth": max(0.0, (np.abs(turn.as_matrix()[:, 2]).sum(-1) * edge / 2 - p[:, 2]).max()) * 1000,
        })  # fmt: skip
    for name in errors[0]:
        assert metrics[f"toss_{name}"]["value"] == pytest.approx(np.mean([e[name] for e in errors]), rel=1e-6), name
    at_step = round(document["sample_time_s"] / real.dt)
    own, other = (f.of("cubes", "position")[f.steps.index(at_step)][:, 0, :2] for f in (run, real))
    assert metrics["w1_real"]["value"] == pytest.approx(_w1(own, other), rel=1e-9)


def test_memory_model_and_price(gsb_eval: Command) -> None:
    """The line through the memory of a sweep, its largest N, and the ratio of two levels of determinism."""
    document = _evaluated(gsb_eval, "prices-h100/mjx-jax-*.mcap", "sweeps-h100/physx-free-fall-*.mcap")
    (sweep,) = (s for s in document["sweeps"] if s["scene"] == "free-fall")
    memory = {p["n_env"]: p["memory_peak_increment"] * 1e9 for p in sweep["points"] if p["memory_peak_increment"]}
    n, m = np.array(list(memory), float), np.array(list(memory.values()))
    fitted = np.polyfit(n, m, 1, w=1 / m)  # least squares of relative errors
    model = sweep["memory_models"]["memory_peak_increment"]
    assert [model["per_env_bytes"], model["fixed_bytes"]] == pytest.approx(list(fitted), rel=1e-6)
    rows, off = np.stack([n, np.ones_like(n)], axis=1) / m[:, np.newaxis], np.polyval(fitted, n) / m - 1
    errors = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)) * (off**2).sum() / (len(n) - 2))
    assert [model["per_env_se_bytes"], model["fixed_se_bytes"]] == pytest.approx(list(errors), rel=1e-6)
    assert model["relative_residuals"] == pytest.approx(list(off), rel=1e-6)
    files = _files("sweeps-h100/physx-free-fall-*.mcap")
    assert sweep["n_env_max"] == max(f.n_env for f in files if f.messages["/run/end"][0].status == 1)
    fps = {g["label"]: g["metrics"]["fps"]["value"] for g in document["groups"]}
    per_run = {g["label"]: g["metrics"]["fps"]["extra"]["per_run"] for g in document["groups"] if fps[g["label"]]}
    (price,) = document["price_list"]
    for level in price["levels"]:
        found, sides = level["throughput_of_default"], (level["group"], price["default"]["group"])
        assert found["ratio"] == pytest.approx(fps[sides[0]] / fps[sides[1]], rel=1e-12)
        variances, freedoms = np.transpose([_variance_of_log(per_run[side]) for side in sides])
        freedom = variances.sum() ** 2 / (variances**2 / freedoms).sum()  # Welch and Satterthwaite
        half = student.ppf(0.975, freedom) * np.sqrt(variances.sum())
        assert found["ci95"] == pytest.approx(list(found["ratio"] * np.exp([-half, half])), rel=1e-9)


def _variance_of_log(values: list[float]) -> tuple[float, int]:
    """The delete-one jackknife's variance of the logarithm of a mean, and its degrees of freedom."""
    n = len(values)
    left = np.log([np.delete(values, r).mean() for r in range(n)])
    return (n - 1) / n * float(((left - left.mean()) ** 2).sum()), n - 1


@pytest.mark.parametrize("simulator", ["physx-inclined", "newton-xpbd-run-to-run", "isaaclab-ovphysx"])
def test_probe(gsb_probe: Command, simulator: str) -> None:
    """Pairs, differing pairs and the first step of each question, from the hashes of states."""
    files = _files(f"probe-h100/{simulator}*.mcap")
    paths = sorted(_RECORDINGS.glob(f"probe-h100/{simulator}*.mcap"))
    (probe,) = json.loads(gsb_probe(*paths, "--json", "-", code=0).stdout)["probes"]
    arms: dict[tuple[int, str], list[NDArray[np.uint64]]] = defaultdict(list)
    for f in files:
        begun, treated = f.asked.get("initial", ""), f.asked.get("intervention", "")
        arms[f.n_env, f"{begun} {treated}".strip()].append(f.hashes())
    alike, (drawn, *_) = arms[16, ""][0], arms[16, "random:0.1"]
    reset = arms[16, "random:0.1 reset@100"][0]
    others = [h for (n, begun), (h, *_) in arms.items() if n != 16 and begun == "random:0.1"]
    sides = {
        "envs": [(alike[:, 1:], alike[:, :1].repeat(15, axis=1))],
        "number": [(h[:, :16], drawn[:, : h.shape[1]]) for h in others],
        "slot": [(np.roll(arms[16, "random:0.1,shift:5"][0], 5, axis=1), drawn)],
        "neighbours": [(arms[16, "random:0.1,but:0"][0][:, :1], drawn[:, :1])],
        "poison": [(np.delete(h, 1, axis=1), np.delete(drawn, 1, axis=1)) for h in arms[16, "random:0.1 poison@100"]],
        "bystanders": [(reset[:, 1::2], drawn[:, 1::2])],
        "fresh": [(reset[101:, ::2], alike[1:201, ::2])],
        "restored": [(arms[16, "random:0.1 excursion@100+30"][0], drawn)],
        "set": [(arms[16, "random:0.1 set@100"][0], drawn)],
    }
    asked = {answer["key"]: answer["found"] for answer in probe["answers"] if answer["found"]}
    assert len(asked) > 5
    for key in asked.keys() & sides.keys():
        differ = [a != b for a, b in sides[key]]
        first = [int(d.any(axis=1).argmax()) for d in differ if d.any()]
        expected = sum(d.shape[1] for d in differ), sum(int(d.any(axis=0).sum()) for d in differ)
        assert (asked[key]["pairs"], asked[key]["differing"]) == expected, key
        step = min(first) + (101 if key == "fresh" else 0) if first else None
        assert asked[key]["first_step"] == step, key


def _laws(gsb_eval: Command, *asked: object) -> tuple[_File, dict[str, Any]]:
    (path,) = recorded("--sim", "mujoco", "--n-env", 8, "--runs", 1, "--phases", "capture", *asked)
    laws = json.loads(gsb_eval(path, "--json", "-", "--no-cache", code=0).stdout)["groups"][0]["laws"]
    return _File(path), {law["key"]: law for law in laws}


def test_double_pendulum(gsb_eval: Command) -> None:
    """Energies, and periods and tolerances of the normal modes, from Lagrange's equations and joint angles."""
    run, laws = _laws(gsb_eval, "--scene", "double-pendulum", "--initial", "random:0.8")
    (_, link, *_) = run.scene["robot"]["links"]  # all rods are alike
    mass, about, way, apart = link["inertial"]["mass"], link["inertial"]["inertia"][0], 0.25, 0.5
    inertia = np.array([[about + mass * (way**2 + apart**2), mass * apart * way], [0.0, about + mass * way**2]])
    inertia[1, 0] = inertia[0, 1]
    stiffness = np.diag([mass * _GRAVITY * (way + apart), mass * _GRAVITY * way])
    squares, modes = eigh(stiffness, inertia)
    slow, fast = 2 * np.pi / np.sqrt(squares)
    angle, speed = ([run.of("robot", f)[..., k, 0] for k in range(4)] for f in ("qpos", "qvel"))
    rows = int(np.ceil(slow / run.dt))
    for name, k in (("large", 0), ("small", 2)):
        a, b, da, db = angle[k], angle[k] + angle[k + 1], speed[k], speed[k] + speed[k + 1]
        kinetic = (inertia[0, 0] * da**2 + inertia[1, 1] * db**2) / 2 + inertia[0, 1] * np.cos(a - b) * da * db
        energy = kinetic + stiffness[0, 0] * (1 - np.cos(a)) + stiffness[1, 1] * (1 - np.cos(b))
        gained = energy[-rows:].mean(axis=0) / energy[:rows].mean(axis=0) - 1
        assert laws[f"{name}_energy"]["measured"] == pytest.approx(gained.mean(), rel=1e-6)
        tolerance = run.dt / slow + (2 * np.pi / fast * run.dt) ** 2
        assert laws[f"{name}_energy"]["tolerance"] == pytest.approx(tolerance, rel=1e-9)
    for mode, (name, period) in enumerate((("slow", slow), ("fast", fast))):
        along = np.tensordot(inertia @ modes[:, mode], np.stack([a, b]), axes=1)  # of the small swing
        up = [np.nonzero((x[:-1] < 0) & (x[1:] >= 0))[0] for x in along.T]
        times = [(i + x[i] / (x[i] - x[i + 1])) * run.dt for i, x in zip(up, along.T, strict=True)]
        found = np.mean([(t[-1] - t[0]) / (len(t) - 1) for t in times])
        law = laws[f"{name}_period"]
        assert (law["measured"], law["predicted"]) == (pytest.approx(found, rel=1e-4), pytest.approx(period, rel=1e-9))
        largest = max(np.abs(a).max(), np.abs(b).max())
        tolerance = run.dt / min(len(t) - 1 for t in times) + period * largest**2
        assert law["tolerance"] == pytest.approx(tolerance, rel=1e-6)


def test_ball(gsb_eval: Command) -> None:
    """Contact, restitution and smallest change that two recordings show, from parabolas and Student's t."""
    run, laws = _laws(gsb_eval, "--scene", "ball-drop", "--initial", "random:0.5")
    height, speed = run.of("balls", "position")[:, :, 2, 2] - 0.05, run.of("balls", "linear_velocity")[:, :, 2, 2]
    at, away = [], []
    for h, v in zip(height.T, speed.T, strict=True):
        free = np.abs(np.diff(v) + _GRAVITY * run.dt) < 0.01 * _GRAVITY * run.dt
        last = int((~free).argmax())
        met = np.sqrt(v[last] ** 2 + 2 * _GRAVITY * h[last])
        at.append(last * run.dt + (v[last] + met) / _GRAVITY)
        flying = [i for i in np.nonzero(free)[0] if i > last and v[i] > 0 and h[i] >= 0 and i * run.dt - at[-1] < 0.3]
        away.append(np.sqrt(v[flying[0]] ** 2 + 2 * _GRAVITY * h[flying[0]]) / met if flying else 0.0)
    impact = np.sqrt(speed[0] ** 2 + 2 * _GRAVITY * height[0])
    time, n = (speed[0] + impact) / _GRAVITY, run.n_env
    law = laws["high_contact"]
    assert (law["measured"], law["predicted"]) == pytest.approx((np.mean(at), time.mean()), rel=1e-12)
    assert laws["high_restitution"]["measured"] == pytest.approx(np.mean(away), rel=1e-9, abs=1e-12)
    assert laws["high_gain"]["tolerance"] == pytest.approx(2 * _GRAVITY * run.dt / impact.min(), rel=1e-12)
    effect = height[0] / impact - time  # of a share of 1 of g
    k = max(0.1, *(x.std(ddof=1) / abs(x.mean()) for x in (effect, time)))
    s = law["sd"] / np.sqrt(n) * np.sqrt((n - 1) / chi2.ppf(0.05, n - 1))
    scale = (student.ppf(0.975, 2 * n - 2) + student.ppf(0.95, 2 * n - 2)) ** 2 * np.pi / 3
    least = np.sqrt(scale * 2 * s**2 / (1 - scale * k**2 / n)) / abs(effect.mean())
    (gravity,) = (x for x in law["sensitivities"] if x["parameter"] == "gravity")
    assert gravity["least"] == pytest.approx(least, rel=1e-9)


def test_info() -> None:
    """Sizes, rates, peaks of memory and readings of the hardware, of a run that continues another one."""
    (path,) = _RECORDINGS.glob("vary-h100/warp-run-to-run-*T032239Z.mcap")
    (told,), run = json.loads(call("gsb-info", path, "--json", "-", code=0).stdout)["files"], _File(path)
    (clock,), (capture,) = run.messages["/timing/capture"], [told["captured"]]
    seconds = (clock.end_ns[-1] - clock.start_ns[0]) * 1e-9
    rate = run.n_env * (run.steps[-1] - run.steps[0]) / seconds
    assert (capture["first_step"], capture["steps"]) == (run.steps[0], run.steps[-1] - run.steps[0])
    assert (capture["seconds"], capture["env_steps_per_s"]) == pytest.approx((seconds, rate), rel=1e-12)
    for source, memory in told["memory"].items():
        samples = run.messages[f"/memory/{source}"]
        assert (memory["readings"], memory["peak"]) == (len(samples), max(s.used_bytes for s in samples))
    power = [s.power_mw for s in run.messages["/hardware/gpu0"]]
    assert told["hardware"]["gpu0"]["values"]["power_mw"] == pytest.approx([min(power), np.mean(power), max(power)])
    for array in told["arrays"]:
        state = run.raw[tuple(array["name"].split("/"))]
        assert (array["shape"], array["bytes"]) == (list(state.shape), state.nbytes)


def _cuts(y: Array, level: float) -> dict[int, float]:
    """Circular binary segmentation with every part of every stretch as a candidate: first points of levels, and p."""
    found: dict[int, float] = {}
    while True:
        pairs = list(pairwise([0, *sorted(found), len(y)]))
        total, f = sum(((y[a:b] - y[a:b].mean()) ** 2).sum() for a, b in pairs), len(y) - len(pairs) - 1
        ranked = []
        for a, b in pairs:
            n = b - a
            for i, j in combinations(range(1, n + 1), 2):
                part, rest = y[a + i : a + j], np.r_[y[a : a + i], y[a + j : b]]
                between = len(part) * len(rest) / n * (part.mean() - rest.mean()) ** 2
                ways, cuts = ((n - 1) * (n - 2) / 2, [a + i, a + j]) if j < n else (n - 1, [a + i])
                ranked.append((4 * ways * student.sf(np.sqrt(f * between / (total - between)), f), cuts))
        p, cuts = min(ranked)
        if p > level:
            return found
        found |= {cut: p for cut in cuts if cut not in found}


def test_history(tmp_path: Path) -> None:
    """Points, change points with p and interval, and the smallest change that one more point would show."""
    for index in range(14):
        write_point(tmp_path / "history", index, factor=1.1 if 5 <= index < 9 else 1.0)
    said = call("gsb-compare", "--history", tmp_path / "history", "--json", "-", code=0).stdout
    (told,) = json.loads(said)["configurations"]
    (curve,) = (c for c in told["curves"] if c["changes"])
    points = []
    for index in range(14):
        runs = [_File(path) for path in sorted((tmp_path / "history" / f"v{index}").iterdir())]
        points.append([run.n_env / run.step_s for run in runs])
    assert [s["value"] for s in curve["samples"]] == pytest.approx(list(np.mean(points, axis=1)), rel=1e-9)
    y, tested = np.log(points).mean(axis=1), sum(not c["exact"] for c in told["curves"])
    cuts = _cuts(y, 0.05 / tested)
    assert [c["point"] for c in curve["changes"]] == sorted(cuts) == [5, 9]
    ends = [0, *sorted(cuts), len(y)]
    levels = [y[a:b] for a, b in pairwise(ends)]
    for change, (one, other) in zip(curve["changes"], pairwise(levels), strict=True):
        f, shift = len(one) + len(other) - 2, other.mean() - one.mean()
        spread = sum(((x - x.mean()) ** 2).sum() for x in (one, other)) / f * (1 / len(one) + 1 / len(other))
        half = student.ppf(0.975, f) * np.sqrt(spread)
        assert change["p_value"] == pytest.approx(cuts[change["point"]], rel=1e-6)
        found = [change["ratio"], *change["ci95"]]
        assert found == pytest.approx(list(np.exp([shift, shift - half, shift + half])), rel=1e-9)
    f, m = len(y) - len(levels), len(levels[-1])
    scatter = np.sqrt(sum(((x - x.mean()) ** 2).sum() for x in levels) / f * (1 + 1 / m))
    visible = np.exp(student.isf(0.05 / tested / (4 * m), f) * scatter)
    assert curve["smallest_visible"] == pytest.approx(visible, rel=1e-9)


def test_leaderboard(tmp_path: Path) -> None:
    """Places by throughput, and which row is not shown to be slower than the row above."""
    files = ("prices-h100/warp-*.mcap", "sweeps-h100/[gw]*-franka-n32768-*.mcap")
    paths = {path.name: path for pattern in files for path in _RECORDINGS.glob(pattern)}
    call("gsb-share", "leaderboard", *paths.values(), "--out", tmp_path / "board", code=0)
    sections = json.loads((tmp_path / "board" / "leaderboard.json").read_text())["sections"]
    for section in sections:
        runs = [[_File(paths[r["name"]]) for r in row["recordings"]] for row in section["rows"]]
        above, own = ([run.n_env / run.step_s for run in row] for row in runs)
        assert [row["place"] for row in section["rows"]] == [1, 2]
        found = [row["throughput"]["value"] for row in section["rows"]]
        assert found == pytest.approx([np.mean(above), np.mean(own)], rel=1e-9)
        variances, freedoms = np.transpose([_variance_of_log(x) for x in (above, own)])
        half = student.ppf(0.975, variances.sum() ** 2 / (variances**2 / freedoms).sum()) * np.sqrt(variances.sum())
        assert (section["rows"][1]["equals"] == 1) == (0 < np.log(found[0] / found[1]) < half)
    assert [section["rows"][1]["equals"] for section in sections] == [None, 1]
