"""Packing and unpacking: smaller files of the same content, checked on the way, and nothing overwritten."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, unknown_fields
from mcap.reader import make_reader

from gpusimbench import open_recording
from gpusimbench.evaluator.player.viewer import write_view
from gpusimbench.evaluator.read.copying import Copier, records_of
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.evaluator.share.copies import pack, recover, unpack
from gpusimbench.schemas.blocks import pack_state
from gpusimbench.schemas.errors import DamagedRecording, DataLost, UsageError
from gpusimbench.schemas.messages import embedded_schema, widened_schema
from gpusimbench.schemas.writing import new_file
from tests.conftest import call
from tests.evaluator.damaged import BYTES, whole
from tests.limits import next_to_no_memory
from tests.synthetic import configured, grid, write_recording
from tests.test_docs import ROOT, commands

SHIPPED = ROOT / "recordings" / "mujoco-pyramidal-r0.mcap"
FLOAT32 = ROOT / "recordings" / "h200" / "physx-inclined-collision-n16-r0.mcap"


def share(*arguments: object, folder: Path | None = None, code: int | None = None) -> subprocess.CompletedProcess[str]:
    """Call gsb-share as a user does."""
    return call("gsb-share", *arguments, cwd=folder, code=code)


def contents(path: Path) -> tuple[list[Any], list[Any], list[Any]]:
    """Messages, attachments and metadata, as the mcap library reads them."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        messages = [
            (schema.name, schema.data, c.topic, c.metadata, c.message_encoding, m.log_time, m.publish_time, m.sequence,
             m.data)
            for schema, c, m in reader.iter_messages(log_time_order=False)
            if schema is not None
        ]  # fmt: skip
        attachments = [(a.name, a.media_type, a.log_time, a.create_time, a.data) for a in reader.iter_attachments()]
        metadata = [(m.name, m.metadata) for m in reader.iter_metadata()]
    return messages, attachments, metadata


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 70 environments, so two columns of blocks, that all move differently."""
    final = grid(70, "float32")
    moved = np.random.default_rng(0).normal(0, 1e-3, final.shape).astype(np.float32)
    return write_recording(
        tmp_path_factory.mktemp("moving"), final, steps=60, dt=0.01, name="moving.mcap",
        path_of=lambda start, step: (start + moved * np.float32(step * 0.01)).astype(np.float32),
    )  # fmt: skip


@pytest.mark.parametrize("source", [SHIPPED, FLOAT32], ids=lambda p: p.stem)
def test_real_recordings_keep_their_identity(source: Path, tmp_path: Path) -> None:
    """Pack a shipped recording: the same hash and digests, the same states."""
    packed = pack(source, tmp_path / "packed" / source.name, level=1)
    before, after = open_recording(source), open_recording(packed.path)
    verify(after)
    assert before.content_hash == after.content_hash == packed.content_hash
    assert (packed.bytes_before, packed.bytes_after) == (source.stat().st_size, packed.path.stat().st_size)
    for field in before.fields:
        assert np.array_equal(
            np.asarray(before.state(field.group, field.field)).view(np.uint8),
            np.asarray(after.state(field.group, field.field)).view(np.uint8),
        )


def test_everything_else_is_copied(moving: Path, tmp_path: Path) -> None:
    """Give back, unpacked, every message and attachment with its times and number; packed, change states alone."""
    packed = pack(moving, tmp_path / "packed.mcap", level=3)
    unpacked = unpack(packed.path, tmp_path / "unpacked.mcap")
    assert contents(unpacked.path) == contents(moving)
    assert packed.bytes_after < 0.5 * packed.bytes_before
    before, after = contents(moving), contents(packed.path)
    assert after[1:] == before[1:]
    for was, became in zip(before[0], after[0], strict=True):
        assert became[:-1] == was[:-1]
        assert (became[-1] == was[-1]) != was[2].startswith("/state/")


def test_packed_and_raw_blocks_in_one_file(moving: Path, tmp_path: Path) -> None:
    """Read packed blocks and raw ones beside each other: a short block of noise is not worth packing."""
    noise = np.random.default_rng(2).normal(size=(1, 27, 3))
    source = write_recording(tmp_path, noise, steps=1, dt=0.01, name="noise.mcap")
    packed = pack(source, tmp_path / "packed.mcap", level=1)
    assert np.array_equal(open_recording(packed.path).state("cubes", "position")[-1], noise)


def test_reading_more_than_the_file_takes(moving: Path, tmp_path: Path) -> None:
    """Read arrays that are larger than the packed file, whole and in part."""
    still = write_recording(tmp_path, grid(70), steps=100, dt=0.01, name="still.mcap")
    packed = pack(still, tmp_path / "packed.mcap", level=1)
    states = open_recording(packed.path).state("cubes", "position")
    assert np.asarray(states).nbytes > 20 * packed.bytes_after
    assert np.array_equal(np.asarray(states), np.asarray(open_recording(still).state("cubes", "position")))
    assert np.array_equal(states[3:60, 66:], np.asarray(states)[3:60, 66:])


def test_a_packed_file_cannot_announce_more_than_it_holds(tmp_path: Path) -> None:
    """Refuse to allocate for environments that no block holds, though packed blocks may hold more than the file."""

    source = write_recording(tmp_path, grid(4), steps=50, dt=0.01, change=configured(n_env=1 << 22))
    with new_file(tmp_path / "packed.mcap") as target:
        copier = Copier(target, source, compression="zstd", change=pack_state)
        for record, _, _ in records_of(source):
            copier.add(record)
        copier.finish()
    states = open_recording(tmp_path / "packed.mcap").state("cubes", "position")
    with next_to_no_memory(), pytest.raises(DamagedRecording, match="more numbers than the file holds"):
        states[0]


def test_metrics_are_the_same(moving: Path, tmp_path: Path) -> None:
    """Evaluate a packed recording to the same metrics."""
    pack(moving, tmp_path / "moving.mcap", level=1)
    found = []
    for path in (moving, tmp_path / "moving.mcap"):
        done = call("gsb-eval", path, "--sample-time", "0.6", "--json", "-", code=0)
        found.append(json.loads(done.stdout)["groups"])
    assert json.dumps(found[0]).replace(str(moving), "") == (
        json.dumps(found[1]).replace(str(tmp_path / "moving.mcap"), "")
    )


def test_a_damaged_source_is_not_packed(moving: Path, tmp_path: Path) -> None:
    """Refuse what was changed, and leave nothing behind."""
    data = bytearray(moving.read_bytes())
    data[len(data) // 2] ^= 1
    (tmp_path / "bad.mcap").write_bytes(data)
    with pytest.raises(DamagedRecording):
        pack(tmp_path / "bad.mcap", tmp_path / "out" / "bad.mcap", level=1)
    assert not (tmp_path / "out").exists()


def test_what_has_no_end_is_not_packed(tmp_path: Path) -> None:
    """Point to recover where a file was cut short, and refuse where nothing says what it should hold."""
    partial = write_recording(tmp_path, grid(2), steps=3, end=False, name="cut.mcap")
    with pytest.raises(DataLost, match="gsb-share recover"):
        pack(partial, tmp_path / "packed.mcap", level=1)


def test_nothing_is_overwritten(moving: Path, tmp_path: Path) -> None:
    """Refuse a name that is taken, its own included, and leave no other file behind."""
    own = tmp_path / "own.mcap"
    own.write_bytes(moving.read_bytes())
    (tmp_path / "a.mcap").write_text("mine")
    for name in ("a.mcap", "own.mcap"):
        with pytest.raises(UsageError, match="exists already"):
            pack(own, tmp_path / name, level=1)
    assert (tmp_path / "a.mcap").read_text() == "mine"
    assert own.read_bytes() == moving.read_bytes()
    assert len(list(tmp_path.iterdir())) == 2


def test_the_command_packs_a_folder(moving: Path, tmp_path: Path) -> None:
    """Pack a folder and what is named, one line each; what cannot be is named, and the rest is written."""
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "one.mcap").write_bytes(moving.read_bytes())
    (folder / "two.mcap").write_text("no recording")
    done = share("pack", folder, "--out", tmp_path / "out", code=3)
    assert done.stdout.count("\n") == 1
    assert "content hash" in done.stdout
    assert "two.mcap is not an MCAP file" in done.stderr
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["one.mcap"]
    share("unpack", tmp_path / "out" / "one.mcap", "--out", tmp_path / "back", code=0)
    assert contents(tmp_path / "back" / "one.mcap") == contents(moving)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("pack", SHIPPED, "--level", "0"), "--level is a whole number from 1 to 22"),
        (("pack", ROOT / "docs"), "is a folder without recordings"),
        (("pack", "missing.mcap"), "cannot read missing.mcap"),
        ((), "VERB"),
    ],
)
def test_what_cannot_be_asked(arguments: tuple[object, ...], message: str, tmp_path: Path) -> None:
    """Say in one line what is wrong with a command, and write nothing."""
    done = share(*arguments, folder=tmp_path)
    assert done.returncode in (2, 3)
    assert message in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_commands_of_the_page(tmp_path: Path) -> None:
    """Run every command that docs/share.md shows, in a folder that has the sample recordings."""
    (tmp_path / "recordings").mkdir()
    for path in (ROOT / "recordings").glob("mujoco-*-r0.mcap"):
        (tmp_path / "recordings" / path.name).write_bytes(path.read_bytes())
    lines = commands(ROOT / "docs" / "share.md")
    assert len(lines) == 2
    for line in lines:
        name, *arguments = line.split()
        assert name == "gsb-share"
        files = [str(p.relative_to(tmp_path)) for p in sorted(tmp_path.glob("recordings/*.mcap"))]
        expanded = [file for a in arguments for file in (files if a == "recordings/*.mcap" else [a])]
        done = share(*expanded, folder=tmp_path, code=0)
        assert done.stdout


def undescribed(path: Path) -> list[str]:
    """Topics of messages with a field that the schema beside them in the file does not have."""
    found, classes = [], {}
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            if schema.data not in classes:
                pool = descriptor_pool.DescriptorPool()
                for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                    pool.Add(file)
                kind = pool.FindMessageTypeByName(schema.name)
                classes[schema.data] = message_factory.GetMessageClass(kind)
            if _unknown(classes[schema.data].FromString(message.data)):
                found.append(channel.topic)
    return found


def _unknown(message: Any) -> bool:
    if len(unknown_fields.UnknownFieldSet(message)):
        return True
    # of a map there are values, and those of ours are no messages
    values = [(f, v) for f, v in message.ListFields() if f.message_type and not f.message_type.GetOptions().map_entry]
    return any(_unknown(one) for f, value in values for one in (value if f.is_repeated else [value]))


@pytest.mark.parametrize("source", [SHIPPED, FLOAT32], ids=lambda p: p.stem)
def test_every_schema_describes_every_byte(source: Path, tmp_path: Path) -> None:
    """Find no unknown field in what pack, unpack, recover and the view write of a recording older than packing."""
    packed, back, whole = (tmp_path / name for name in ("packed.mcap", "back.mcap", "whole.mcap"))
    pack(source, packed, level=1)
    unpack(packed, back)
    cut = tmp_path / "cut.mcap.partial"
    cut.write_bytes(packed.read_bytes()[:-100])
    recover(cut, whole)
    made = write_view(source, tmp_path / "view.mcap", envs=[0], rate=10.0, spread=1.0)
    for path in (source, packed, back, whole, made.path):
        assert undescribed(path) == [], path


def test_a_file_that_was_packed_without_its_schema_is_recovered_with_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Give recovered blocks a schema that describes them, and keep what is newer, or is no schema, as it is."""
    packed, cut = tmp_path / "packed.mcap", tmp_path / "cut.mcap.partial"
    with monkeypatch.context() as older:
        older.setattr("gpusimbench.evaluator.read.copying.widened_schema", lambda _, stored: stored)
        pack(SHIPPED, packed, level=1)
    assert undescribed(packed)
    cut.write_bytes(packed.read_bytes()[:-100])
    assert undescribed(recover(cut, tmp_path / "whole.mcap").path) == []
    newer = descriptor_pb2.FileDescriptorSet.FromString(embedded_schema("gsb.v1.StateBlock"))
    newer.file[0].message_type[0].field.add(name="later", number=999, type=3, label=1)
    for stored in (newer.SerializeToString(), b"\xff no schema", bytes(2 << 20)):
        assert widened_schema("gsb.v1.StateBlock", stored) == stored


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("no CRC", "crc-present"),
        ("summary-count", "summary"),
        ("summary-chunk-moved", "summary"),
        ("summary-without-attachment", "summary"),
    ],
)
def test_packing_mends_what_the_rules_say_that_it_mends(name: str, rule: str, tmp_path: Path) -> None:
    """Break no rule any more whose advice is to pack the file."""
    path = ROOT / "tests" / "hostile" / "found" / f"{name}.mcap"
    if name in BYTES:
        path = whole(tmp_path)
        path.write_bytes(BYTES[name][1](path.read_bytes()))
    assert share("pack", path, "--out", tmp_path / "packed").returncode == 0
    found = []
    for file in (path, tmp_path / "packed" / path.name):
        findings = json.loads(call("gsb-check", file, "--json", "-").stdout)["findings"]
        found.append({one["rule"] for one in findings if "gsb-share pack" in one["do"]})
    assert found == [{rule}, set()]
