"""A set of tosses as its authors publish it, or as arrays, in SI units and ready to begin simulations with.

Two forms are read: a folder of files 0.pt, 1.pt, ... (as ContactNets publishes them), and an archive of arrays, .npz.
Nothing of a file is executed: of a .pt file the operations of its pickle are compared with those of a matrix of
float64, and its numbers are taken from behind it.
"""

from __future__ import annotations

import hashlib
import io
import math
import os
import pickletools
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.cube_toss import EDGE, RATE
from gpusimbench.schemas import arrays
from gpusimbench.schemas.errors import DamagedRecording, UsageError
from gpusimbench.schemas.initial import Given
from gpusimbench.schemas.tosses import GROUP, MAX_TOSSES, NOTICE, TossSet
from gpusimbench.schemas.tosses import SYNTHETIC as SYNTHETIC_SOURCE
from gpusimbench.schemas.treatment import TEACHER
from gpusimbench.schemas.view.kinematics import rotate

VARIABLE = "GSB_CUBE_TOSS"
"""Environment variable with the path of the set, where --tosses is not given."""

SYNTHETIC = Path(__file__).parent / "synthetic_tosses.npz"
"""The set that is used where there is no other: made by benchmarks.make_tosses with known parameters."""

PUBLISHED = "a402d2981dff88835edcfc3bc5fc396bd6869888cf5b5bbfaeb03e288718d310"
"""SHA-256 of the published set, in either form."""

_HALF = EDGE / 2  # the unit of length of the published files [m]
_WIDTHS = {"position": 3, "quaternion": 4, "velocity": 3, "angular_velocity": 3}
_GRAVITY = 9.81
_NEAR = 0.005  # height above the table at which tracking cannot tell a corner that touches it [m]
_COLUMNS = 19  # of a published file: position, quaternion, velocity, angular velocity, and six of a control, all zero
_MOST_BYTES = 1 << 28
_FILE = re.compile(r"(\d{1,6})\.pt")

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Tosses:
    """Measured motions, one after another, corrected as `known` says.

    known             what the set is
    first             toss k is rows first[k] to first[k + 1] - 1
    position          of the cube's centre [m], world frame, shape [row, 3]
    orientation       unit quaternion wxyz, body to world, shape [row, 4]
    linear_velocity   [m/s], world frame, as measured: a backward difference
    angular_velocity  [rad/s], world frame
    notice            licence text that has to travel with the data; empty where none lies beside them
    """

    known: TossSet
    first: NDArray[np.int64]
    position: Floats
    orientation: Floats
    linear_velocity: Floats
    angular_velocity: Floats
    notice: str

    def __len__(self) -> int:
        return len(self.known.rows)

    @property
    def synthetic(self) -> bool:
        """Whether nobody measured them."""
        return self.known.source.startswith("synthetic")

    def fields(self) -> dict[str, Floats]:
        """The measured rows by name of a state field."""
        return {
            "position": self.position,
            "orientation": self.orientation,
            "linear_velocity": self.linear_velocity,
            "angular_velocity": self.angular_velocity,
        }

    def states(self) -> dict[str, Floats]:
        """The same as states that a simulation is set to.

        A measured velocity is the mean over the interval before its row. Where the cube falls freely in that interval,
        half an interval of gravity makes it the velocity of the row: at the first row of a toss, and wherever the
        lowest corner is more than 5 mm above the table at the row and at the row before. Elsewhere a contact may have
        changed the velocity meanwhile, and the measured number is kept.
        """
        free = self.position[:, 2] - lowest(self.orientation) > _NEAR
        free[1:] &= free[:-1].copy()
        free[self.first[:-1]] = True
        velocity = self.linear_velocity.copy()
        velocity[free, 2] -= _GRAVITY / RATE / 2
        return {**self.fields(), "linear_velocity": velocity}

    def steps(self, scene: Scene) -> int:
        """Steps between rows that a recording of them has: up to the scene's sample time, or the longest toss."""
        return max(round(scene.sample_time * RATE), max(self.known.rows) - 1)

    def side_by_side(self, rows: Floats, steps: int) -> Floats:
        """Rows [row, width] as [step, toss, width], from step 0 to `steps`; a toss that ended keeps its last row."""
        after = np.arange(steps + 1)[:, np.newaxis]
        return np.asarray(rows[np.minimum(self.first[:-1] + after, self.first[1:] - 1)])

    def initial(self, n_env: int, every: int = 0) -> tuple[str, bytes]:
        """What environments begin with: the text of a RunConfiguration and its attachment.

        Environment e begins as toss e modulo the number of tosses, with the velocities of `states`.

        every  where it is above 0, the attachment has every so manieth row after the first, too (treatment.TEACHER)
        """
        states = self.states()
        begin = self.first[:-1][np.arange(n_env) % len(self)]
        found: dict[str, NDArray[Any]] = {
            f"{GROUP}/{name}": rows[begin][:, np.newaxis] for name, rows in states.items()
        }
        if every:
            used = min(n_env, len(self))
            later = [np.arange(self.first[t] + every, self.first[t + 1], every) for t in range(used)]
            found[f"{TEACHER}first"] = np.concatenate([[0], np.cumsum([len(rows) for rows in later])])
            chosen = np.concatenate(later)
            found |= {f"{TEACHER}{GROUP}/{name}": rows[chosen][:, np.newaxis] for name, rows in states.items()}
        if self.notice:
            found[NOTICE] = np.array(self.notice)
        data = arrays.encode(found)
        return str(Given(hashlib.sha256(data).hexdigest())), data


def read_tosses(path: Path | None) -> Tosses:
    """The set at a path: a .npz file, a folder that has one called tosses.npz, or a folder of .pt files.

    path  None: that of the environment variable GSB_CUBE_TOSS, else the synthetic set

    UsageError says what is wrong with what is there.
    """
    if path is None:
        path = Path(os.environ[VARIABLE]) if os.environ.get(VARIABLE) else SYNTHETIC
    try:
        raw = _read(path)
    except OSError as error:
        raise UsageError(f"--tosses {path}: {error.strerror or error}") from None
    except DamagedRecording as error:
        raise UsageError(f"--tosses {path}: {error}") from None
    first = raw.pop("first").astype(np.int64)
    sha256 = hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in (first, *raw.values()))).hexdigest()
    return _corrected(raw, first, _source(path, sha256), sha256, "" if path == SYNTHETIC else _notice(path))


def _source(path: Path, sha256: str) -> str:
    if path == SYNTHETIC:
        return SYNTHETIC_SOURCE
    return "the measured tosses of ContactNets (arXiv 2009.11193)" if sha256 == PUBLISHED else "measured tosses"


def _corrected(raw: dict[str, Any], first: NDArray[np.int64], source: str, sha256: str, notice: str) -> Tosses:
    last = first[1:] - 1
    # even tosses are for fitting; odd ones are held out, of this number too
    scale = _HALF / float(np.median(raw["position"][last[::2], 2]))
    position = raw["position"] * scale
    left = error_of_g(position[:, 2], first)
    known = TossSet(
        source=source,
        sha256=sha256,
        rows=tuple(int(n) for n in np.diff(first)),
        length_scale=scale,
        corrections=(
            f"lengths were multiplied by {scale:.5f}, so that the median height at rest of even tosses is half an edge"
            + ("" if math.isnan(left) else f"; free fall is then {left:+.2%} off {_GRAVITY} m/s2"),
            "angular velocities were turned from the body's frame to the world's",
        ),
    )
    return Tosses(
        known,
        first,
        position,
        raw["quaternion"],
        raw["velocity"] * scale,
        rotate(raw["quaternion"], raw["angular_velocity"]),
        notice,
    )


def lowest(quaternion: Floats) -> Floats:
    """How far the lowest corner of the cube is below its centre [m], shape [row], of orientations [row, 4] wxyz."""
    w, x, y, z = quaternion.T
    vertical = np.abs(np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]))
    return np.asarray(vertical.sum(axis=0) * _HALF)


def _read(path: Path) -> dict[str, Any]:
    if not path.is_dir():
        return _of_archive(path)
    if (path / "tosses.npz").is_file():
        return _of_archive(path / "tosses.npz")
    files = {int(found[1]): file for file in path.iterdir() if (found := _FILE.fullmatch(file.name))}
    if not files:
        raise UsageError(f"--tosses {path}: the folder has neither tosses.npz nor files 0.pt, 1.pt, ...")
    if len(files) > MAX_TOSSES or sorted(files) != list(range(len(files))):
        missing = next(number for number in range(len(files) + 1) if number not in files)
        raise UsageError(f"--tosses {path}: {missing}.pt is missing; tosses are numbered from 0 on")
    tables = [_table(files[number]) for number in range(len(files))]
    rows = np.concatenate(tables)
    first = np.concatenate([[0], np.cumsum([len(table) for table in tables])])
    return _checked({
        "first": first,
        "position": rows[:, :3] * _HALF,
        "quaternion": rows[:, 3:7],
        "velocity": rows[:, 7:10] * _HALF,
        "angular_velocity": rows[:, 10:13],
    })  # fmt: skip


def _of_archive(path: Path) -> dict[str, Any]:
    if path.stat().st_size > _MOST_BYTES:
        raise DamagedRecording(f"{path.name} has more than {_MOST_BYTES} bytes")
    found = arrays.decode(path.name, path.read_bytes(), most=_MOST_BYTES)
    if missing := [name for name in ("first", *_WIDTHS) if name not in found]:
        raise DamagedRecording(f"{path.name} has no array '{missing[0]}'; a set has first, {', '.join(_WIDTHS)}")
    return _checked({name: found[name] for name in ("first", *_WIDTHS)})


def _checked(found: dict[str, Any]) -> dict[str, Any]:
    first = found["first"]
    if first.ndim != 1 or first.dtype.kind not in "iu" or not 2 <= len(first) <= MAX_TOSSES + 1:
        raise DamagedRecording(f"'first' has shape {first.shape} and type {first.dtype}; it is a list of whole numbers")
    if first[0] != 0 or (np.diff(first.astype(np.int64)) < 2).any():
        raise DamagedRecording("'first' does not begin with 0, or a toss has fewer than two rows")
    for name, width in _WIDTHS.items():
        array = found[name]
        if array.shape != (first[-1], width) or array.dtype.kind != "f" or not np.isfinite(array).all():
            raise DamagedRecording(
                f"'{name}' has shape {array.shape} and type {array.dtype}; it is [{first[-1]}, {width}], finite numbers"
            )
        found[name] = array.astype(np.float64)
    if not np.allclose(np.linalg.norm(found["quaternion"], axis=1), 1.0, atol=1e-3):
        raise DamagedRecording("'quaternion' has rows that are no unit quaternions")
    return found


_MATRIX = (
    "PROTO", "GLOBAL torch._utils _rebuild_tensor_v2", "BINPUT", "MARK", "MARK", "BINUNICODE storage", "BINPUT",
    "GLOBAL torch DoubleStorage", "BINPUT", "BINUNICODE", "BINPUT", "BINUNICODE cpu", "BINPUT", "COUNT", "NONE",
    "TUPLE", "BINPUT", "BINPERSID", "COUNT", "COUNT", "COUNT", "COUNT", "TUPLE3", "BINPUT", "COUNT", "COUNT", "COUNT",
    "TUPLE3", "BINPUT", "NEWFALSE", "GLOBAL collections OrderedDict", "BINPUT", "EMPTY_TUPLE", "REDUCE", "BINPUT",
    "TUPLE", "BINPUT", "REDUCE", "BINPUT", "STOP",
)  # fmt: skip
"""The operations of the pickle of a matrix of float64 in the form before PyTorch 1.6; COUNT is a whole number."""


def _table(path: Path) -> Floats:
    """The matrix [row, 19] of a file that torch.save wrote before PyTorch 1.6."""
    data = path.read_bytes()
    stream = io.BytesIO(data)
    try:
        for _ in range(3):  # a magic number, a protocol's number, sizes of the writer's types
            for _ in pickletools.genops(stream):
                pass
        found = list(pickletools.genops(stream))
        for _ in pickletools.genops(stream):  # names of storages: there is one
            pass
    except Exception:  # whatever pickletools says of bytes that are no pickle
        raise DamagedRecording(
            f"{path.name} is no matrix that torch.save wrote in the form before PyTorch 1.6"
        ) from None
    names = [(("COUNT" if o.name.startswith("BININT") else o.name), value) for o, value, _ in found]
    if len(names) != len(_MATRIX) or not all(
        wanted in (name, f"{name} {value}") for wanted, (name, value) in zip(_MATRIX, names, strict=True)
    ):
        raise DamagedRecording(f"{path.name} holds something else than a matrix of float64")
    size, offset, *layout = (int(value or 0) for name, value in names if name == "COUNT")
    rows, columns = layout[1:3]
    if columns != _COLUMNS or offset or layout != [1, rows, columns, size, columns, 1] or size != rows * columns:
        raise DamagedRecording(f"{path.name} is a matrix of shape {layout[:3]}; a toss has 1, its rows, {_COLUMNS}")
    at = stream.tell()
    content = data[at + 8 :]
    if len(content) != 8 * size or int.from_bytes(data[at : at + 8], "little") != size:
        raise DamagedRecording(f"{path.name} is not as long as its {rows} rows")
    return np.frombuffer(content, "<f8").reshape(rows, columns).astype(np.float64)


def _notice(path: Path) -> str:
    """The licence text nearest to the data: beside them, or up to two folders above."""
    folder = path if path.is_dir() else path.parent
    for place in (folder, *folder.absolute().parents[:2]):
        for file in sorted(place.glob("LICENSE*")):
            try:
                return file.read_text(encoding="utf-8")
            except (OSError, UnicodeDecodeError):
                continue
    return ""


def error_of_g(height: Floats, first: NDArray[np.int64]) -> float:
    """Free fall over that of gravity, less one; NaN where no toss falls for long enough.

    From parabolas through the first heights [m] of each toss, while the cube is higher than its half diagonal.

    first  toss k is heights first[k] to first[k + 1] - 1
    """
    found = []
    for begin, end in zip(first[:-1], first[1:], strict=True):
        heights = height[begin:end]
        below = heights < _HALF * math.sqrt(3.0)
        free = int(np.argmax(below)) if below.any() else len(heights)
        if free >= 8:
            found.append(-2.0 * np.polyfit(np.arange(free) / RATE, heights[:free], 2)[0])
    return float(np.mean(found)) / _GRAVITY - 1.0 if found else math.nan
