"""Anybody can read a recording, and gets the published metrics from it, with none of our code."""

from __future__ import annotations

import itertools
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from gpusimbench import open_recording
from tests.conftest import Command, finished
from tests.synthetic import grid, metrics_of, write_recording


def read_with_the_embedded_schema(path: Path, topic: str) -> tuple[dict[str, str], NDArray[np.float64]]:
    """Channel metadata and array [step, env, item, width], by the official reader and the schema in the file."""
    parts = []
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, _, block in reader.iter_decoded_messages(topics=[topic]):
            numbers = block.data64 if len(block.data64) else block.data
            parts.append(np.array(numbers).reshape(block.steps, block.envs, block.items, block.width))
            metadata = channel.metadata
    return metadata, np.concatenate(parts)


def w1_cm(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """W1 [cm] by scipy, straight from the definition."""
    cost = cdist(a, b)
    return float(cost[linear_sum_assignment(cost)].mean() * 100.0)


@pytest.mark.parametrize("group", ["cubes", "ball"])
@pytest.mark.parametrize("field", ["position", "orientation", "linear_velocity", "angular_velocity"])
def test_every_array_with_its_meaning(small: Path, group: str, field: str) -> None:
    """Give every array, its unit, frame, components and names to a reader that has only the file."""
    metadata, array = read_with_the_embedded_schema(small, f"/state/{group}/{field}/000000")
    ours = open_recording(small).state(group, field)
    assert np.array_equal(array, np.asarray(ours))
    assert metadata["unit"] == ours.field.unit
    assert metadata["frame"] == "world"
    assert metadata["items"].split(",") == list(ours.field.items)
    assert metadata["components"].split(",") == list(ours.field.components)
    assert metadata["dtype"] == "float64"
    assert metadata["dt"] == "0.01"


def test_every_w1_from_the_files_by_scipy(gsb_eval: Command, tmp_path: Path) -> None:
    """Reproduce every W1 to 1e-9 cm from the embedded schemas and scipy alone."""
    rng = np.random.default_rng(5)
    files = [write_recording(tmp_path, grid(4) + rng.normal(0, 0.01, (4, 27, 3)), run=r) for r in range(3)]
    reference = write_recording(tmp_path, grid(4) + rng.normal(0, 0.01, (4, 27, 3)), simulator="other")
    done = gsb_eval(*files, "--reference", reference, "--json", "-", code=0)
    metrics = metrics_of(done.stdout)

    final = [read_with_the_embedded_schema(f, "/state/cubes/position/000000")[1][5, :, :, :2] for f in files]
    target = read_with_the_embedded_schema(reference, "/state/cubes/position/000000")[1][5, :, :, :2]
    parallel = [np.mean([w1_cm(a, b) for a, b in itertools.combinations(run, 2)]) for run in final]
    pairs = [w1_cm(a.reshape(-1, 2), b.reshape(-1, 2)) for a, b in itertools.combinations(final, 2)]
    gaps = [w1_cm(run.reshape(-1, 2), target.reshape(-1, 2)) for run in final]
    for name, values in (("w1_parallel", parallel), ("w1_run_to_run", pairs), ("w1_real", gaps)):
        assert metrics[name]["value"] == pytest.approx(np.mean(values), abs=1e-9)
        assert metrics[name]["sd"] == pytest.approx(np.std(values, ddof=1), abs=1e-9)
        assert metrics[name]["unit"] == "cm"


_NODE_TEST = Path(__file__).with_name("read_state.mjs")


@pytest.mark.slow
def test_another_language_reads_the_same(small: Path, tmp_path: Path) -> None:
    """Give Node, with @mcap/core and protobufjs, the same positions from the embedded schema."""
    if not (shutil.which("node") and shutil.which("npm")):
        pytest.skip("node and npm are not installed")
    install = subprocess.run(
        ["npm", "install", "--no-audit", "--no-fund", "--no-package-lock", "--prefix", str(tmp_path),
         "@mcap/core@2", "protobufjs@7"],
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    if install.returncode != 0:
        pytest.skip(f"npm cannot install @mcap/core here: {install.stderr.splitlines()[:1]}")
    script = tmp_path / "read_state.mjs"
    script.write_text(_NODE_TEST.read_text())
    done = finished(["node", str(script), str(small), "/state/cubes/position/000000"], cwd=tmp_path)
    read: dict[str, Any] = json.loads(done.stdout)
    array = np.array(read["numbers"]).reshape(read["shape"])
    assert np.array_equal(array, np.asarray(open_recording(small).state("cubes", "position")))
    assert read["metadata"]["unit"] == "m"
