"""Good recordings to be spoiled: small, of every kind that the format knows, by the recorder's own hand."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.provenance import Buffer, OverflowBit
from tests.conftest import call
from tests.synthetic import Shown, grid, write_recording

_TINY = ("--runs", 1, "--steps", 6, "--warmup", 2, "--timed-steps", 4)


def _shown(n_env: int) -> Shown:
    contacts = np.arange(5 * n_env).reshape(5, n_env)
    stream = message_class("gsb.v1.ActionStream")(
        generator="{}", steps=5, envs=n_env, first_sha256="0" * 64, last_sha256="1" * 64, verified=True
    )
    return Shown(
        counts={"capture": {"contacts": contacts}, "timed": {"contacts": contacts[:2]}},
        overflow={"capture": np.array([[0] * n_env] * 4 + [[2] + [0] * (n_env - 1)], dtype=np.uint32)},
        bits=(OverflowBit(1, "full", fatal=False),),
        buffers=(Buffer("contacts", 100, "env", "contacts"),),
        streams={"capture": stream},
    )


def make_synthetic(folder: Path) -> list[Path]:
    """Write those of no simulator; everything but clocks is the same each time."""
    rich: dict[str, Any] = {
        "gpu_bytes": (10**9, 2 * 10**9), "host_bytes": (10**8, 10**8), "allocator_peak": 10**8,
        "clocks": {"build": 1.0, "compile_timed": 0.5}, "environment": {"XLA_FLAGS": "-"},
    }  # fmt: skip
    made = [
        write_recording(
            folder, grid(n_env), compression=compression, name=f"synthetic-{compression}.mcap", shown=_shown(n_env),
            origins=tuple((float(i), 0.0, 0.0) for i in range(n_env)), run_id=f"synthetic {compression}", **rich,
        )
        for n_env, compression in ((2, "none"), (3, "lz4"), (2, "zstd"))
    ]  # fmt: skip
    # more environments than one block holds: several topics a field
    made.append(write_recording(folder, grid(70, "float32"), name="columns.mcap", run_id="columns", compression="lz4"))
    made.append(
        write_recording(
            folder, grid(2), name="failed.mcap", run_id="failed", status="FAILED", reason="it broke", cause="ENGINE",
            dropout="the disk was slow", shown=_shown(2),
        )
    )  # fmt: skip
    made.append(write_recording(folder, grid(2), name="incomplete.mcap", run_id="incomplete", end=False, **rich))
    return made


def make_corpus(folder: Path) -> list[Path]:
    """Write all of it; everything but random names and clocks is the same each time."""
    made = make_synthetic(folder)
    for scene, compression in (("franka", "none"), ("inclined-collision", "lz4"), ("inclined-collision", "zstd")):
        done = call("gsb-record", "--sim", "mujoco", "--scene", scene, "--n-env", 3 if scene == "franka" else 2, *_TINY,
                    "--compression", compression, "--out", folder, code=0)  # fmt: skip
        made.append(Path(done.stdout.strip()))
    for number, path in enumerate(made):  # their order; several are written within a tick of the file system's clock
        os.utime(path, (number, number))
    return made
