"""Observed images in recordings of vector environments: hashes of frames, or their numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from gpusimbench import open_recording, wrap
from gpusimbench.evaluator.cli.check import main as check
from gpusimbench.evaluator.cli.diff import main as diff
from gpusimbench.recorder.log import RecordingWriter
from gpusimbench.replay.cli import main as replay
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.fields import array_field
from gpusimbench.schemas.images import image_hash_note, image_hashes
from tests.recorder.test_wrap import MODES

SHAPE = (5, 7, 3)
N_ENV = 3


class Camera(gymnasium.Env):  # type: ignore[misc,name-defined]
    """Episodes of four steps with a picture and a number; `spot`, of an environment and a step, has one other pixel."""

    metadata = {"render_fps": 20}  # noqa: RUF012
    observation_space = gymnasium.spaces.Dict(
        {"pixels": gymnasium.spaces.Box(0, 255, SHAPE, np.uint8), "at": gymnasium.spaces.Box(-9, 9, (2,), np.float32)}
    )
    action_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)

    def __init__(self, spot: int = -1) -> None:
        self.spot, self.calls = spot, 0

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.step_of = 0
        return self.seen(), {}

    def seen(self) -> Any:
        pixels = self.np_random.integers(0, 256, SHAPE, dtype=np.uint8)
        if self.calls == self.spot:
            pixels[2, 3, 1] ^= 1
        return {"pixels": pixels, "at": np.full(2, self.step_of, np.float32)}

    def step(self, action: Any) -> Any:
        self.step_of += 1
        self.calls += 1
        return self.seen(), 0.0, self.step_of == 4, False, {}


def played(path: Path, mode: str = "SameStep", spot: int = -1, **keywords: Any) -> list[Any]:
    """Record ten steps of three environments, of which the last may have the spot; returns what they observed."""
    vector = gymnasium.vector.SyncVectorEnv(
        [Camera, Camera, lambda: Camera(spot)], autoreset_mode=gymnasium.vector.AutoresetMode(mode)
    )
    envs = wrap(vector, path, **keywords)
    seen = [envs.reset(seed=4)[0]]
    for _ in range(10):
        observation, _, terminated, truncated, info = envs.step(np.zeros((N_ENV, 1), np.float32))
        seen.append({**observation, "info": info, "done": terminated | truncated})
        if mode == "Disabled" and terminated.any():
            seen[-1] |= envs.reset(options={"reset_mask": terminated})[0]
    envs.close()
    return seen


@pytest.mark.parametrize("mode", MODES)
def test_the_hash_of_every_frame_is_recorded(mode: str, tmp_path: Path) -> None:
    """Record 16 bytes a frame, also of last frames of episodes, and say so; other observations stay as they are."""
    seen = played(tmp_path / "a.mcap", mode)
    recording = open_recording(tmp_path / "a.mcap")
    fields = {field.field: field for field in recording.fields}
    assert "observation_pixels" not in fields
    for name in ("observation_pixels_hash", "final_observation_pixels_hash"):
        assert "sum-splitmix64-v1 hash of each image, uint8 5x7x3, which is not recorded itself" in fields[name].note
        assert fields[name].unit == "1"
    assert recording.configuration.options["images"] == "hash"
    found = recording.state("env", "observation_pixels_hash")[:][:, :, 0]
    assert np.array_equal(found, image_hashes(np.stack([row["pixels"] for row in seen]), lead=2))
    at = recording.state("env", "observation_at")[:][:, :, 0]
    assert np.array_equal(at, np.stack([row["at"] for row in seen]))
    final = recording.state("env", "final_observation_pixels_hash")[:][:, :, 0]
    if mode == "SameStep":
        ends = [row for row in range(1, 11) if seen[row]["done"].any()]
        assert ends == [4, 8]
        for row in ends:
            last = seen[row]["info"]["final_obs"]
            frames = np.stack([one["pixels"] for one in last]) if last.dtype == object else last["pixels"]
            assert np.array_equal(final[row], image_hashes(frames))
    assert check([str(tmp_path / "a.mcap")]) == 0


def test_the_first_frame_that_differs_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Find one bit of one pixel of one environment by the hashes alone."""
    played(tmp_path / "a.mcap")
    played(tmp_path / "b.mcap", spot=6)
    assert diff([str(tmp_path / "a.mcap"), str(tmp_path / "b.mcap")]) == 4
    said = " ".join(capsys.readouterr().out.split())
    assert "differ first at step 6 (0.3 s), first in env 2: env/observation_pixels_hash[0]: hashes of images" in said
    assert "1 of 3 pairs of envs differ at that step" in said


def test_numbers_of_images_on_demand(tmp_path: Path) -> None:
    """Record every number where the user asks for them, and refuse another word."""
    seen = played(tmp_path / "a.mcap", images="numbers")
    recording = open_recording(tmp_path / "a.mcap")
    found = recording.state("env", "observation_pixels")[:].reshape(11, N_ENV, *SHAPE)
    assert np.array_equal(found, np.stack([row["pixels"] for row in seen]))
    assert "images" not in recording.configuration.options
    with pytest.raises(UsageError, match="images is 'hash' or 'numbers', not 'none'"):
        played(tmp_path / "b.mcap", images="none")


def cameras(n_env: int) -> Any:
    """What gsb-replay steps."""
    return gymnasium.vector.SyncVectorEnv([Camera] * n_env, autoreset_mode=gymnasium.vector.AutoresetMode.SAME_STEP)


@pytest.mark.parametrize("images", ["hash", "numbers"])
def test_images_are_replayed(images: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Replay with what was recorded of images, so that every observation is compared."""
    played(tmp_path / "a.mcap", images=images)
    again = tmp_path / "again.mcap"
    assert replay([str(tmp_path / "a.mcap"), "--make", f"{__name__}:cameras", "--out", str(again)]) == 0
    assert "bit-identical" in capsys.readouterr().out
    names = {field.field for field in open_recording(again).fields}
    assert ("observation_pixels_hash" in names, "observation_pixels" in names) == (images == "hash", images != "hash")


def test_programs_record_hashes_of_their_cameras(tmp_path: Path) -> None:
    """Write hashes without wrap, of frames of any dtype; one other number gives another hash."""
    frames = np.random.default_rng(0).normal(size=(3, N_ENV, 4, 5)).astype(np.float16)
    field = array_field("camera", "float64", (2,), note=image_hash_note(frames.dtype, frames.shape[2:]))
    with RecordingWriter(
        tmp_path / "a.mcap", simulator="mine", version="1", scene="task", n_env=N_ENV, dt=0.1, steps=None,
        fields=(field,),
    ) as log:  # fmt: skip
        for row in frames:
            log.append(image_hashes(row))
    found = open_recording(tmp_path / "a.mcap").state("env", "camera")[:][:, :, 0]
    other = frames.copy()
    other[1, 2, 3, 4] += 1
    changed = (image_hashes(other, lead=2) != found).any(axis=2)
    assert np.argwhere(changed).tolist() == [[1, 2]]
