"""What a fuzzer does not find by luck: sizes, depths, counts, and files that are no plain files."""

from __future__ import annotations

import gc
import os
import random
import resource
import socket
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gpusimbench import open_recording
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.schemas.blocks import decode_state
from gpusimbench.schemas.errors import DamagedRecording, NotARecording
from gpusimbench.schemas.messages import message_class
from tests.conftest import Command, run_python
from tests.encoded import encode_state
from tests.hostile import records as mcap
from tests.hostile.contents import with_right_digests
from tests.hostile.mutate import BOMBS, bomb
from tests.hostile.records import Attachment, Chunk, File, Message, Record
from tests.synthetic import Shown, grid, write_recording

_ACCEPTED = {"no size"}


@pytest.fixture
def good(tmp_path: Path) -> Path:
    """A small whole recording."""
    return write_recording(tmp_path, grid(2), name="good.mcap")


def _written(folder: Path, file: File) -> Path:
    path = folder / "spoiled.mcap"
    path.write_bytes(mcap.assemble(file))
    return path


@pytest.mark.parametrize("kind", BOMBS)
def test_bombs(kind: str, good: Path, tmp_path: Path) -> None:
    """Refuse chunks that hold more, less or something else than they announce; read those that do not."""
    path = tmp_path / "bomb.mcap"
    path.write_bytes(bomb(kind, random.Random(0), mcap.parse(good.read_bytes()), 0).data)
    if kind in _ACCEPTED:
        verify(open_recording(path))
    else:
        with pytest.raises(DamagedRecording, match=r"chunk at byte|duplicate"):
            verify(open_recording(path))


def _lines(function: Callable[[], object]) -> int:
    # of Python that are run: a measure of time that no other process changes
    counted = 0

    def count(*_: object) -> object:
        nonlocal counted
        counted += 1
        return count

    before = sys.gettrace()
    gc.collect()
    gc.disable()  # what other tests left has functions that are called when it is collected
    sys.settrace(count)
    try:
        function()
    finally:
        sys.settrace(before)
        gc.enable()
    return counted


def _many_chunks(file: File, number: int) -> File:
    return file.with_records([*file.records(), *[Record(200, b"")] * number], per_chunk=1)


def _many_channels(file: File, number: int) -> File:
    channels = [mcap.pack_channel(1000 + i, 1, f"/count/capture/c{i}") for i in range(number)]
    return file.with_records([*file.records(), *channels], per_chunk=10**6)


def _many_state_channels(file: File, number: int) -> File:
    channels = [mcap.pack_channel(1000 + i, 1, f"/state/cubes/position/{i + 1:06d}") for i in range(number)]
    return file.with_records([*file.records(), *channels], per_chunk=10**6)


def _many_messages(file: File, number: int) -> File:
    (channel,) = (n for n, topic in file.channels().items() if topic == "/run/event")
    sample = message_class("gsb.v1.Event")(kind=3, text="x").SerializeToString()
    messages = [Message(channel, i, 1, 1, sample).record() for i in range(number)]
    return with_right_digests(file.with_records([*file.records(), *reversed(messages)], per_chunk=10**6))


def _many_attachments(file: File, number: int) -> File:
    added = [Attachment(f"{i}.txt", "", b"") for i in range(number)]
    return with_right_digests(File((*file.items, *added)))


@pytest.mark.parametrize(
    "multiply", [_many_chunks, _many_channels, _many_state_channels, _many_messages, _many_attachments]
)
def test_work_grows_as_the_file_does(multiply: Callable[[File, int], File], tmp_path: Path) -> None:
    """Double the work, and no more, for twice as many chunks, channels, messages of a topic, or attachments."""
    event = ("/run/event", "gsb.v1.Event", b"")
    file = mcap.parse(write_recording(tmp_path, grid(1), shown=Shown(raw=(event,))).read_bytes())
    file = File(tuple(item for item in file.items if not (isinstance(item, Record) and item.opcode == mcap.METADATA)))

    def work(number: int) -> int:
        path = tmp_path / f"{number}.mcap"
        path.write_bytes(mcap.assemble(multiply(file, number)))

        def read() -> None:
            try:
                recording = open_recording(path)
                verify(recording)
                _ = recording.events, recording.counts, recording.action_names
            except DamagedRecording:
                pass

        return _lines(read)

    work(10)  # what is loaded on first use
    one, two = work(1000), work(2000)
    assert two < 2.2 * one


def test_work_grows_as_the_states_do(tmp_path: Path) -> None:
    """Double the work, and no more, for twice as many blocks of states: a long run is no hostile one."""
    found = []
    for steps in (500, 1000):
        path = write_recording(tmp_path, grid(1), steps=steps, dt=0.01, name=f"{steps}.mcap")
        array = open_recording(_in_small_blocks(path)).state("cubes", "position")
        assert np.array_equal(array[:], open_recording(path).state("cubes", "position")[:])
        found.append(_lines(lambda array=array: [array[row] for row in range(len(array))]))  # type: ignore[misc]
    assert found[1] < 2.3 * found[0]


def _in_small_blocks(path: Path) -> Path:
    file = mcap.parse(path.read_bytes())
    (channel,) = (n for n, topic in file.channels().items() if topic == "/state/cubes/position/000000")
    found = []
    for record in file.records():
        if record.opcode != mcap.MESSAGE or Message.of(record).channel != channel or not Message.of(record).sequence:
            found.append(record)
            continue
        header, rows = decode_state(Message.of(record).data)
        for row in range(len(rows)):
            step = header.first_step + row
            time = 10_000_000 * step
            data = encode_state(rows[row : row + 1], first_step=step, stride=1, env_start=0, sim_time_ns=time)
            found.append(Message(channel, step, 10**9 + time, 1, data).record())
    return _written(path.parent, file.with_records(found))


def test_zeros_behind_a_crash(tmp_path: Path) -> None:
    """Read what lies before the zeros that a loss of power leaves, without a look at each of them."""
    path = write_recording(tmp_path, grid(2), end=False)
    before = _lines(lambda: open_recording(path))
    with path.open("r+b") as stream:
        stream.truncate(path.stat().st_size + (1 << 30))  # a hole: nothing is written
    after = _lines(lambda: open_recording(path))
    assert after < before + 100
    recording = open_recording(path)
    verify(recording)
    assert recording.status == "incomplete"
    assert np.array_equal(recording.state("cubes", "position")[-1], grid(2))


def test_more_messages_than_the_file_can_tell_apart(good: Path, tmp_path: Path) -> None:
    """Refuse a chunk of a few kilobytes that unpacks into millions of messages."""
    file = mcap.parse(good.read_bytes())
    raw = Message(1, 0, 1, 1, b"").record().bytes() * 1_200_000
    records = [r for r in mcap.split(mcap.assemble(file)) if r.opcode < mcap.DATA_END and r.opcode != mcap.FOOTER]
    path = tmp_path / "many.mcap"
    path.write_bytes(mcap.join([*records, mcap.pack_chunk("zstd", raw, mcap.compress("zstd", raw))]))
    with pytest.raises(DamagedRecording, match="messages, which is refused"):
        open_recording(path)


def test_messages_that_unpack_into_more_than_is_read(good: Path, tmp_path: Path) -> None:
    """Refuse to make objects of messages that are a thousand times the file."""
    file = mcap.parse(good.read_bytes())
    event = message_class("gsb.v1.Event")(kind=3, text="x" * (8 << 20)).SerializeToString()
    added = [mcap.pack_channel(77, 1, "/run/event"), *[Message(77, i, 1, 1, event).record() for i in range(12)]]
    path = _written(tmp_path, file.with_records([*file.records(), *added], compression="zstd", per_chunk=10**6))
    assert path.stat().st_size < 100_000
    with pytest.raises(DamagedRecording, match="unpacks into more than is read"):
        _ = open_recording(path).events


def test_a_state_far_in_the_future(good: Path, tmp_path: Path) -> None:
    """Refuse steps that would need an array of terabytes, before it is made."""
    file = mcap.parse(good.read_bytes())
    (channel,) = (n for n, topic in file.channels().items() if topic == "/state/cubes/position/000000")
    far = 10**10
    found = []
    for record in file.records():
        if record.opcode == mcap.MESSAGE and (message := Message.of(record)).channel == channel and message.sequence:
            block = message_class("gsb.v1.StateBlock").FromString(message.data)
            block.first_step = far
            time = 10**9 + far * 10**9
            record = Message(channel, 1, time, 1, block.SerializeToString()).record()  # noqa: PLW2901
        found.append(record)
    recording = open_recording(_written(tmp_path, file.with_records(found)))
    with pytest.raises(DamagedRecording, match="rows from row 0 on, which cannot be"):
        recording.state("cubes", "position")


def test_hashes_of_more_environments_than_there_can_be(tmp_path: Path) -> None:
    """Refuse many steps of one hash each that would be filled up to sixteen million environments."""
    blocks = [
        message_class("gsb.v1.FingerprintBlock")(first_step=s, steps=1, envs=1, hashes=[1]).SerializeToString()
        for s in range(64)
    ]
    raw = tuple(("/fingerprint/timed", "gsb.v1.FingerprintBlock", b) for b in blocks)
    path = write_recording(tmp_path, None, n_env=1 << 24, shown=Shown(raw=raw))
    with pytest.raises(DamagedRecording, match="more steps of 16777216 environments than"):
        open_recording(path).fingerprints("timed")


@pytest.mark.parametrize(("depth", "good_one"), [(60, True), (70, False), (700, False)])
def test_depth_of_json(depth: int, good_one: bool, good: Path, tmp_path: Path) -> None:
    """Refuse JSON that is deeper than what handles it later can be expected to take."""
    file = mcap.parse(good.read_bytes())
    nested = b'"options": {"x": ' + b"[" * depth + b"]" * depth + b"}"
    items = [
        Attachment(i.name, i.media_type, i.data.replace(b'"options": {}', nested))
        if isinstance(i, Attachment) and i.name == "simulation.json" else i
        for i in file.items
    ]  # fmt: skip
    path = _written(tmp_path, with_right_digests(File(tuple(items))))
    if good_one:
        verify(open_recording(path))
    else:
        with pytest.raises(DamagedRecording, match="deep within each other"):
            open_recording(path)


def test_an_index_that_tells_another_topic(tmp_path: Path) -> None:
    """Refuse a message of another topic, also where nothing but what is read is checked."""
    file = mcap.parse(write_recording(tmp_path, grid(2), clocks={"build": 1.0, "compile_timed": 2.0}).read_bytes())
    numbers = {topic: n for n, topic in file.channels().items()}
    one, two = numbers["/timing/build"], numbers["/timing/compile_timed"]
    swapped = {one: two, two: one}
    changed = []
    for record in mcap.split(mcap.assemble(file)):
        if record.opcode == mcap.MESSAGE_INDEX:
            (number,) = struct.unpack_from("<H", record.body)
            record = Record(record.opcode, struct.pack("<H", swapped.get(number, number)) + record.body[2:])  # noqa: PLW2901
        changed.append(record)
    path = tmp_path / "swapped.mcap"
    path.write_bytes(mcap.with_right_crcs(mcap.join(changed)))
    with pytest.raises(DamagedRecording, match="disagree on its topic"):
        _ = open_recording(path).timing


def test_a_channel_that_tells_another_unit(good: Path, tmp_path: Path) -> None:
    """Refuse a file from which two programs would read different units."""
    file = mcap.parse(good.read_bytes())
    found = [
        Record(r.opcode, r.body.replace(b"\x04\0\0\0unit\x01\0\0\0m", b"\x04\0\0\0unit\x01\0\0\0k"))
        if r.opcode == mcap.CHANNEL else r
        for r in file.records()
    ]  # fmt: skip
    with pytest.raises(DamagedRecording, match=r"position/000000 and simulation\.json disagree on unit"):
        verify(open_recording(_written(tmp_path, file.with_records(found))))


_READ_BEHIND_THE_END = """
import os, sys
from gpusimbench import open_recording
from gpusimbench.schemas.errors import DamagedRecording
recording = open_recording(sys.argv[1])
os.truncate(sys.argv[1], 4096)
for read in (recording.check_digests, lambda: recording.timing, lambda: recording.state("cubes", "position")[:],
             lambda: recording.attachment("scene.json")):
    try:
        read()
    except DamagedRecording as error:
        print(error)
"""


def test_a_file_that_becomes_shorter_while_it_is_read(good: Path) -> None:
    """Say so, instead of dying of SIGBUS."""
    done = run_python(_READ_BEHIND_THE_END, good)
    assert done.stdout.count("became shorter while it was read") == 4


def test_what_is_no_plain_file(good: Path, tmp_path: Path) -> None:
    """Refuse devices, sockets, pipes and loops of links by name, without waiting; follow a link."""
    (tmp_path / "loop.mcap").symlink_to("loop.mcap")
    (tmp_path / "link.mcap").symlink_to(good)
    (tmp_path / "zero.mcap").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "pipe.mcap")
    with socket.socket(socket.AF_UNIX) as server:
        here = os.open(tmp_path, os.O_RDONLY)
        server.bind(f"/proc/self/fd/{here}/socket.mcap")  # a socket's path is short
        for name in ("loop", "zero", "pipe", "socket"):
            with pytest.raises(NotARecording, match=rf"{name}\.mcap"):
                open_recording(tmp_path / f"{name}.mcap")
        os.close(here)
    for path in ("/proc/self/status", "nul\0.mcap"):
        with pytest.raises(NotARecording):
            open_recording(path)
    verify(open_recording(tmp_path / "link.mcap"))


def test_a_name_that_is_not_utf8(gsb_eval: Command, tmp_path: Path) -> None:
    """Evaluate, show and report files of any name."""
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/b\xff\x1b[2Jd.mcap"))
    write_recording(tmp_path, grid(2), name="x.mcap").rename(path)
    (damaged := tmp_path / os.fsdecode(b"c\xff.mcap")).write_bytes(path.read_bytes()[:-5000])
    done = gsb_eval(path, damaged, "--json", tmp_path / "r.json", "--html", tmp_path / "report", code=3)
    assert "Traceback" not in done.stderr
    assert "\x1b" not in done.stdout + done.stderr
    for name in ("info", "check"):
        shown = subprocess.run(
            [sys.executable, "-m", f"gpusimbench.evaluator.cli.{name}", path], capture_output=True, timeout=300
        )
        assert shown.returncode in (0, 4), shown.stderr  # 4: a rule of provenance that the tests leave out
        assert b"\x1b" not in shown.stdout


def test_more_recordings_than_a_shell_lets_open(gsb_eval: Command, tmp_path: Path) -> None:
    """Open as many recordings as the system allows, though the shell allows fewer."""
    good = write_recording(tmp_path, grid(1), name="good.mcap")
    for number in range(100):
        (tmp_path / f"{number}.mcap").symlink_to(good)

    def few() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (64, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))

    done = gsb_eval("--all", *sorted(tmp_path.glob("*.mcap")), preexec_fn=few, code=0)
    assert done.stdout.count("is a copy of") == 100


def test_reading_leaves_no_trace(gsb_eval: Command, good: Path, tmp_path: Path) -> None:
    """Write nothing beside a file that is read, nor to it: it may lie in a folder that is not ours."""
    before = {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in tmp_path.iterdir()}
    recording = Recording(good)
    verify(recording)
    assert gsb_eval(good, cwd="/").returncode == 0
    assert {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in tmp_path.iterdir()} == before


def test_a_chunk_is_decompressed_once_for_all_its_messages(good: Path, tmp_path: Path) -> None:
    """Read messages as they lie, not as their numbers tell, so that no order of them costs more than another."""
    from gpusimbench.schemas.mcap import decompression

    file = mcap.parse(good.read_bytes())
    events = [message_class("gsb.v1.Event")(kind=3, text=f"{i}").SerializeToString() for i in range(60)]
    order = [i for residue in range(20) for i in range(residue, 60, 20)]
    messages = [Message(77, i, 1, 1, events[i]).record() for i in order]
    added = [mcap.pack_channel(77, 1, "/run/event"), *messages]
    chunks = tuple(Chunk("zstd", tuple(added[i : i + 3])) for i in range(0, len(added), 3))
    recording = open_recording(_written(tmp_path, File((*file.items, *chunks))))
    counted = 0
    decompress = decompression.decompress

    def counting(*arguments: object) -> memoryview:
        nonlocal counted
        counted += 1
        return decompress(*arguments)  # type: ignore[arg-type]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(decompression, "decompress", counting)
        assert [e.text for e in recording.events] == [str(i) for i in range(60)]
    assert counted <= len(chunks)
