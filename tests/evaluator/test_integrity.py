"""Everything that is wrong with a file is found and named, and nothing is found in one that is whole."""

from __future__ import annotations

import os
import random
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench import open_recording
from gpusimbench.evaluator.check.integrity import examine
from gpusimbench.evaluator.check.integrity.problem import DAMAGE, MAX_KEPT, REMARKS, Kind, Problems
from gpusimbench.evaluator.check.integrity.scan import scan
from gpusimbench.evaluator.check.rules.findings import check
from gpusimbench.evaluator.check.rules.rule import Severity, load_rules
from gpusimbench.evaluator.inputs.reader import read_run
from gpusimbench.evaluator.missing import Missing
from gpusimbench.recorder.capture import state_work
from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording, ExitCode, FailedCrc
from gpusimbench.schemas.mcap.decompression import decompress
from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.provenance import LOGGED, PROVENANCE, SCENE, SIMULATION
from gpusimbench.schemas.source import MappedFile
from tests.evaluator.damaged import (
    BYTES,
    REWRITTEN,
    SCENE_CHANGED,
    WRITTEN,
    hashes_of_others,
    places,
    rewritten,
    whole,
)
from tests.evaluator.test_strangers import FORGERIES
from tests.synthetic import Shown, changing, configured, grid, write_recording

ROOT = Path(__file__).resolve().parents[2]
INTEGRITY = load_rules("integrity-1")


def broken(path: Path) -> set[str]:
    """Rules of integrity-1 that a file breaks."""
    return {finding.rule.id for finding in check([examine(path)], [INTEGRITY]).findings}


def kinds(path: Path) -> set[Kind]:
    """Kinds of what is wrong with a file."""
    return set(examine(path).problems.kinds())


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_nothing_is_wrong_with_a_whole_file(tmp_path: Path, compression: str) -> None:
    """Find nothing in a recording of the recorder's own writers, however its chunks are compressed."""
    assert kinds(whole(tmp_path, compression=compression)) == set()


def test_nothing_is_wrong_with_a_real_run(small_set: list[Path]) -> None:
    """Find nothing in runs of a simulator, and ask every rule of integrity-1 that applies."""
    report = check([examine(path) for path in small_set], [INTEGRITY])
    assert report.findings == ()
    assert report.unchecked == ()
    assert report.exit_code == ExitCode.OK
    assert {file.held for file in report.files} == {
        sum(rule.of.name == "file" and not rule.when for rule in INTEGRITY.rules)
    }


def test_the_shipped_recordings_are_whole() -> None:
    """Find no damage in a recording of each kind that ships, with indexes of messages and without."""
    kinds_of_files = ("*-r0", "h200/*-n64-r0", "sweeps-h100/*-n512-r0")
    shipped = [path for kind in kinds_of_files for path in (ROOT / "recordings").glob(f"{kind}.mcap")]
    assert len(shipped) > 8
    for path in shipped:
        assert kinds(path) <= REMARKS, path.name


@pytest.mark.parametrize("damage", BYTES)
def test_changed_bytes_are_named(damage: str, tmp_path: Path) -> None:
    """Name the rule that a change of bytes breaks."""
    rule, change = BYTES[damage]
    path = whole(tmp_path)
    path.write_bytes(change(path.read_bytes()))
    assert rule in broken(path)


@pytest.mark.parametrize("damage", REWRITTEN)
def test_changed_messages_are_named(damage: str, tmp_path: Path) -> None:
    """Name the rule that a change of messages breaks whose CRCs were all made right again."""
    rule, change = REWRITTEN[damage]
    source = whole(tmp_path, status="INVALID", reason="an engineer was here", steps=120)
    found = broken(rewritten(source, tmp_path / "again.mcap", change))
    assert rule in found
    assert not {"chunk-crc", "attachment-crc", "data-crc", "summary-crc"} & found


def test_a_copy_by_another_tool_is_whole(tmp_path: Path) -> None:
    """Find nothing in a file that the official library wrote again without a change."""
    assert kinds(rewritten(whole(tmp_path), tmp_path / "again.mcap", list)) == set()


@pytest.mark.parametrize("rule", WRITTEN)
def test_what_a_run_says_of_itself_is_compared(rule: str, tmp_path: Path) -> None:
    """Name the rule that is broken by a file whose bytes are all as its writer meant them."""
    assert broken(whole(tmp_path, **WRITTEN[rule])) == {rule} | ({"whole"} if rule == "end" else set())


def test_another_scene_is_noticed(tmp_path: Path) -> None:
    """Notice a scene that is not the one whose hash the simulator was built with."""
    assert Kind.contradiction in kinds(whole(tmp_path, **SCENE_CHANGED))


def test_hashes_that_are_not_of_the_states(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Name each step whose state hashes are others."""
    hashes_of_others(monkeypatch)
    found = examine(whole(tmp_path))
    assert set(found.problems.kinds()) == {Kind.state_hash}
    assert found.of(Kind.state_hash) == tuple(f"at step {step}" for step in range(6))


def test_hashes_of_a_file_without_an_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Hold state hashes against the states also where no end record claims a digest of them."""
    found = examine(whole(tmp_path, end=False)).problems
    assert (found.of(Kind.state_hash), found.skipped(Kind.state_hash)) == ((), "")
    hashes_of_others(monkeypatch)
    found = examine(whole(tmp_path, end=False)).problems
    assert found.of(Kind.state_hash) == tuple(f"at step {step}" for step in range(6))


def test_hashes_of_a_run_that_was_cut_short(small: Path, tmp_path: Path) -> None:
    """Find no wrong state hash in a run of several fields wherever it was cut, and compare those that are whole."""
    data, compared = small.read_bytes(), 0
    for number in range(12):
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(data[: len(data) * (number + 1) // 13])
        found = examine(cut)
        assert found.of(Kind.state_hash) == ()
        compared += bool(found.recording and found.recording.fields) and not found.problems.skipped(Kind.state_hash)
    assert compared > 0


@pytest.mark.parametrize("end", [True, False])
def test_hashes_of_fields_that_are_not_there(end: bool, tmp_path: Path) -> None:
    """Say that hashes were not compared where a field that they are of has no states."""

    def more(name: str, record: dict[str, Any]) -> None:
        if name == SIMULATION:
            record["fields"].append(record["fields"][0] | {"field": "linear_velocity", "unit": "m/s"})

    found = examine(whole(tmp_path, end=end, change=more))
    assert found.of(Kind.state_hash) == ()
    assert "cubes/linear_velocity are not there" in found.problems.skipped(Kind.state_hash)


def test_steps_without_hashes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Count the steps that have no hashes, and name the first."""
    made = state_work.hash_messages
    monkeypatch.setattr(
        state_work, "hash_messages", lambda hashes, *, first_step: [] if first_step else made(hashes, first_step=0)
    )
    assert examine(whole(tmp_path)).of(Kind.fingerprint) == ("5 of 6 captured steps have none, the first is step 1",)


def test_steps_beyond_what_a_file_can_hold_have_no_hashes(tmp_path: Path) -> None:
    """Count the hashes that are missing of many steps without making room for them."""
    found = examine(whole(tmp_path, change=configured(steps=1 << 40))).of(Kind.fingerprint)
    assert found == (f"{(1 << 40) - 5} of {(1 << 40) + 1} captured steps have none, the first is step 6",)


def _timing(phase: str, *clocks: tuple[int, int], steps: int = 1) -> tuple[str, str, Any]:
    start, end = ([clock[side] for clock in clocks] for side in (0, 1))
    message = message_class("gsb.v1.StepTiming")(steps_per_interval=steps, start_ns=start, end_ns=end)
    return f"/timing/{phase}", "gsb.v1.StepTiming", message


def _event(kind: int, phase: str, ns: int) -> tuple[str, str, Any]:
    return "/run/event", "gsb.v1.Event", message_class("gsb.v1.Event")(kind=kind, phase=phase, monotonic_ns=ns)


def test_the_same_steps_may_be_timed_several_times(tmp_path: Path) -> None:
    """Sum over windows of the same steps, without what lies between them; refuse windows of other steps."""

    def windows(*sizes: int) -> tuple[tuple[str, str, Any], ...]:
        # intervals of 10 ns, 5 ns apart; each window begins a second after the last
        clocks = [[(10**9 * at + 15 * k, 10**9 * at + 15 * k + 10) for k in range(n)] for at, n in enumerate(sizes)]
        return tuple(_timing("timed", *each) for each in clocks)

    asked = configured(timed_steps=4, phases=("timed", "capture"))
    found = open_recording(whole(tmp_path, change=asked, elapsed_s=None, shown=Shown(raw=windows(4, 4, 4)))).timing[
        "timed"
    ]
    assert (found.times_of(4), found.windows) == (3, (0, 4, 8))
    assert found.elapsed_s == pytest.approx(3 * 55e-9)
    assert found.window_s == pytest.approx(55e-9)
    assert found.first_end_ns == 55
    for sizes, whole_ in (
        ((4,), True),
        ((4, 4), True),
        ((8,), False),
        ((4, 3), False),
        ((3, 4), False),
        ((2, 2), False),
    ):
        problems = examine(whole(tmp_path, change=asked, elapsed_s=None, shown=Shown(raw=windows(*sizes)))).of(
            Kind.contradiction
        )
        assert any("4 steps were to be timed" in problem for problem in problems) is not whole_, sizes


def test_a_warm_up_has_clocks(tmp_path: Path) -> None:
    """Ask a complete run for as many clocks of the warm-up as it says that it had steps."""
    asked = configured(warmup=5)
    assert examine(whole(tmp_path, change=asked)).of(Kind.contradiction) == (
        "5 steps were to come first; there are clocks of 0 intervals",
    )
    for intervals, steps, whole_ in ((5, 1, True), (3, 2, True), (4, 1, False), (3, 1, False)):
        clocks = _timing("warmup", *((2 * k, 2 * k + 1) for k in range(intervals)), steps=steps)
        found = examine(whole(tmp_path, change=asked, shown=Shown(raw=(clocks,))))
        assert (found.of(Kind.contradiction) == ()) == whole_, (intervals, steps)


def test_a_program_that_logs_itself_clocks_no_warm_up(tmp_path: Path) -> None:
    """Ask no clocks of the warm-up of a program that is no adapter: it hands over those of the timed steps."""

    def logged(name: str, record: dict[str, Any]) -> None:
        configured(warmup=5)(name, record)
        changing(SIMULATION, fresh_start=LOGGED)(name, record)

    assert examine(whole(tmp_path, change=logged)).of(Kind.contradiction) == ()


@pytest.mark.parametrize("clock", ["capture", "stall", "drain"])
def test_clocks_of_the_capture_lie_in_its_phase(clock: str, tmp_path: Path) -> None:
    """Take a clock of the capture that lies in its phase, or that has no interval; name one that lies outside."""
    phase = (_event(1, "capture", 100), _event(2, "capture", 200))

    def found(*clocks: tuple[int, int]) -> tuple[str, ...]:
        raw = (*phase, _timing(clock, *clocks, steps=50))
        return examine(whole(tmp_path, shown=Shown(raw=raw))).of(Kind.clock)

    assert found((100, 150), (150, 200)) == found() == ()
    assert found((150, 250)) == (f"/timing/{clock} is clocked outside of the phase capture",)


def test_the_capture_has_a_clock_of_each_block(tmp_path: Path) -> None:
    """Hold the intervals of the capture against its steps, where it has clocks."""
    raw = _timing("capture", (1, 2), (2, 3), steps=2)
    assert examine(whole(tmp_path, shown=Shown(raw=(raw,)))).of(Kind.contradiction) == (
        "5 steps were to be captured; there are clocks of 2 intervals",
    )


@pytest.mark.parametrize(
    ("first", "last", "wrong"),
    [
        ({}, {"omitted_readings": 9}, 0),
        ({"omitted_readings": 1}, {}, 1),
        ({}, {"used_bytes": 6, "omitted_readings": 9}, 2),
        ({}, {"phase": "capture", "omitted_readings": 9}, 2),
        ({}, {"other_processes": 1, "omitted_readings": 9}, 2),
        ({}, {"omitted_readings": (1 << 32) - 1}, 2),
    ],
)
def test_readings_that_were_left_out(tmp_path: Path, first: dict[str, Any], last: dict[str, Any], wrong: int) -> None:
    """Believe in readings that were left out between two that are equal, as far as there was time for them."""
    sample, topic = message_class("gsb.v1.MemorySample"), "/memory/gpu0/device"
    equal = {"source": 2, "used_bytes": 5, "phase": "timed"}
    raw = [sample(**{**equal, "monotonic_ns": at, **told}) for at, told in ((10**9, first), (2 * 10**9, last))]
    shown = Shown(raw=tuple((topic, "gsb.v1.MemorySample", reading) for reading in raw))
    told = examine(whole(tmp_path, shown=shown)).of(Kind.contradiction)
    said = f"message {wrong} of {topic} says that {raw[wrong - 1].omitted_readings} reading"
    assert [why.startswith(said) for why in told] == [True] * bool(wrong)


def test_a_comparison_that_cannot_end_is_not_called_kept(tmp_path: Path) -> None:
    """Find a phase without an end beside a memory reading that cannot be; without one, leave open what needs it."""
    absurd = message_class("gsb.v1.MemorySample")(source=1, monotonic_ns=1, used_bytes=1 << 63, phase="timed")
    reading = ("/memory/host", "gsb.v1.MemorySample", absurd)
    both = examine(whole(tmp_path, shown=Shown(raw=(_event(1, "timed", 10), reading))))
    assert both.of(Kind.clock) == ("phase timed has 1 begins and ends, not one of each",)
    report = check([examine(whole(tmp_path, shown=Shown(raw=(reading,))))], [INTEGRITY])
    assert {finding.rule.id for finding in report.findings} == {"streams"}
    assert {one.rule.id: one.reason for one in report.unchecked} == dict.fromkeys(
        ("clocks", "consistent"), "/memory/host has a reading that no memory can have"
    )


def test_what_an_error_leaves_open_is_told() -> None:
    """Skip the kinds that were looked for where something was raised; look for all where nothing was."""
    problems = Problems()
    with problems.noting(Kind.stream, Kind.digest):
        raise ValueError("too large")
    with problems.skipping(Kind.clock):
        raise DamagedRecording("gone")
    with problems.noting(Kind.stream, Kind.observer), problems.skipping(Kind.dropout):
        pass
    assert problems.of(Kind.stream) == ("too large",)
    skipped = {kind: problems.skipped(kind) for kind in Kind if problems.skipped(kind)}
    assert skipped == {Kind.digest: "too large", Kind.clock: "gone"}
    with pytest.raises(KeyboardInterrupt), problems.skipping(Kind.clock):
        raise KeyboardInterrupt


def test_attachments_are_parsed_once(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Parse each JSON attachment once for all that is asked of a file: it may be large."""
    parsed: list[str] = []
    load = checks.load
    monkeypatch.setattr(checks, "load", lambda name, *given: parsed.append(name) or load(name, *given))
    check([examine(small)], [INTEGRITY, load_rules("protocol-1")])
    assert sorted(parsed) == [PROVENANCE, SCENE, SIMULATION]


def test_all_of_several_problems_are_found(tmp_path: Path) -> None:
    """Report an attachment's CRC, a chunk's, a dropout and an unknown record of one file together."""
    path = whole(tmp_path, dropout="the disk was full")
    data = path.read_bytes()
    for damage in ("a record that nobody knows", "an attachment", "a chunk"):
        data = BYTES[damage][1](data)
    path.write_bytes(data)
    found = broken(path)
    assert {"attachment-crc", "chunk-crc", "data-crc", "known-records", "digests"} <= found
    digests = examine(path).of(Kind.digest)
    assert any("attachment provenance.json was changed" in problem for problem in digests)


@given(seed=st.integers(0, 2**32))
def test_no_flipped_bit_passes(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    """Find something wrong wherever one bit of a file is changed, in the summary too."""
    folder = tmp_path_factory.getbasetemp()
    source = folder / "flip-source.mcap"
    if not source.exists():
        whole(folder, name=source.name)
    data = bytearray(source.read_bytes())
    generator = random.Random(seed)
    data[generator.randrange(len(data))] ^= 1 << generator.randrange(8)
    (folder / "flipped.mcap").write_bytes(data)
    assert kinds(folder / "flipped.mcap")


@given(share=st.floats(0, 1, exclude_max=True))
def test_no_cut_passes(tmp_path_factory: pytest.TempPathFactory, share: float) -> None:
    """Find that a file was cut short, wherever it was; raise nothing."""
    folder = tmp_path_factory.getbasetemp()
    source = folder / "cut-source.mcap"
    if not source.exists():
        whole(folder, name=source.name)
    data = source.read_bytes()
    (folder / "cut.mcap").write_bytes(data[: int(share * len(data))])
    assert kinds(folder / "cut.mcap") & {Kind.cut_short, Kind.not_a_recording}


@pytest.mark.parametrize("forgery", FORGERIES)
def test_forged_files_raise_nothing(forgery: str, tmp_path: Path) -> None:
    """Name what is wrong with each of the forged files that strangers may send."""
    path = write_recording(tmp_path, grid(2), **FORGERIES[forgery])
    assert check([examine(path)], [INTEGRITY]).exit_code != ExitCode.OK


def test_chunks_take_no_more_memory_than_they_hold() -> None:
    """Refuse a chunk that holds more than it announces, in zstd and lz4, without decompressing all of it."""
    import lz4.frame
    import zstandard

    zeros = bytes(1 << 25)
    for compression, packed in (("zstd", zstandard.compress(zeros)), ("lz4", lz4.frame.compress(zeros))):
        assert len(decompress(compression, memoryview(packed), len(zeros))) == len(zeros)
        with pytest.raises(ValueError, match="holds more|does not end where"):
            decompress(compression, memoryview(packed), 1000)
        with pytest.raises(ValueError, match="cannot be decompressed|announces"):
            decompress(compression, memoryview(packed[: len(packed) // 2]), len(zeros))
        with pytest.raises(ValueError, match="announces"):
            decompress(compression, memoryview(packed), 1 << 40)
    with pytest.raises(ValueError, match=f"it is compressed with '{'x' * 40}', which is not known here"):
        decompress("x" * 41, memoryview(b""), 0)


def test_what_was_not_looked_at_is_not_called_kept(tmp_path: Path) -> None:
    """Hold no rule for kept whose streams could not be read, or whose digests nobody claims; say why."""
    path = whole(tmp_path)
    path.write_bytes(BYTES["an attachment"][1](path.read_bytes()))
    report = check([examine(path)], [INTEGRITY])
    assert {"clocks", "consistent", "no-dropouts", "observer"} <= {one.rule.id for one in report.unchecked}
    assert all(one.reason for one in report.unchecked)
    cut = check([examine(whole(tmp_path, end=False))], [INTEGRITY])
    assert {"digests", "content-hash", "summary", "data-crc"} <= {one.rule.id for one in cut.unchecked}
    assert cut.files[0].held + len(cut.unchecked) + 2 == sum(
        rule.of.name == "file" and not rule.when for rule in INTEGRITY.rules
    )


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_what_to_do_about_a_chunk_that_cannot_be_decompressed(compression: str, tmp_path: Path) -> None:
    """Say what to do, as for a chunk that fails its CRC."""
    path = whole(tmp_path, compression=compression)
    data = bytearray(path.read_bytes())
    magic = {"zstd": b"\x28\xb5\x2f\xfd", "lz4": b"\x04\x22\x4d\x18"}[compression]
    path.write_bytes(data.replace(magic, bytes(4)))
    with pytest.raises(DamagedRecording, match="it cannot be decompressed") as found:
        np.asarray(open_recording(path).state("cubes", "position"))
    assert FailedCrc.advice in found.value.advised


def test_the_streams_of_a_damaged_chunk_are_named(tmp_path: Path) -> None:
    """Say what the chunk is of whose CRC fails, and check the digests of all that lies elsewhere."""
    path = whole(tmp_path, compression="none")
    path.write_bytes(BYTES["a chunk"][1](path.read_bytes()))
    found = examine(path)
    assert "it is of /state/cubes/position/000000" in found.of(Kind.chunk_crc)[0]
    assert found.of(Kind.digest) and all("cubes/position" in problem for problem in found.of(Kind.digest))
    # by the byte at which its record begins, which other commands name, too
    (named,) = re.findall(r"the chunk at byte (\d+)", found.of(Kind.chunk_crc)[0])
    assert int(named) in places(path.read_bytes(), 6)
    with pytest.raises(FailedCrc, match=f"the chunk at byte {named} fails its CRC"):
        np.asarray(open_recording(path).state("cubes", "position"))


def test_many_files_are_not_held_open(tmp_path: Path) -> None:
    """Hold no more than one file descriptor for a file that was examined."""
    import os

    path = whole(tmp_path)
    before = len(os.listdir("/proc/self/fd"))
    held = [examine(path) for _ in range(8)]
    assert len(os.listdir("/proc/self/fd")) - before <= len(held)


def test_problems_are_counted_not_kept() -> None:
    """Keep a bounded number of problems of a kind, and say how many there are."""
    problems = Problems()
    for number in range(1000):
        problems.add(Kind.record, f"record {number}")
    found = problems.of(Kind.record)
    assert len(found) == MAX_KEPT + 1
    assert found[-1] == f"and {1000 - MAX_KEPT} more of this kind"


def test_rules_agree_with_kinds() -> None:
    """Ask of every kind of problem in integrity-1, as damage where it is, as a warning where it is a remark."""
    asked = {rule.fact.removeprefix("problems."): rule for rule in INTEGRITY.rules if rule.fact.startswith("problems.")}
    assert set(asked) == {kind.name for kind in Kind}
    for kind in Kind:
        assert asked[kind.name].damage == (kind in DAMAGE), kind
        assert (asked[kind.name].level is Severity.warning) == (kind in REMARKS), kind


def test_every_rule_of_integrity_can_be_broken() -> None:
    """Have a way to break each rule among these tests, but for the one that no file of ours can."""
    ways = {rule for rule, _ in (*BYTES.values(), *REWRITTEN.values())} | set(WRITTEN)
    elsewhere = {"state-hashes", "hashes-at-every-step", "one-content-a-run"}
    elsewhere |= {"view", "confirmed"}  # test_view_check.py breaks the one, recorder/test_log.py the other
    # the two readers disagree only where one of them is wrong
    assert {rule.id for rule in INTEGRITY.rules} - ways - elsewhere == {"other-reader"}


def test_a_reader_that_disagrees_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Say what the mcap library makes of a file, where it reads it in another way."""
    from gpusimbench.evaluator.check.integrity import examination

    class Deaf(examination.StreamReader):  # type: ignore[misc]
        @property
        def records(self):  # type: ignore[no-untyped-def]
            return iter(())

    path = whole(tmp_path)
    monkeypatch.setattr(examination, "StreamReader", Deaf)
    assert "it finds 0 messages" in examine(path).of(Kind.library)[0]


def test_numbers_of_environments_beyond_reason(tmp_path: Path) -> None:
    """Allocate nothing for a file that announces what it cannot hold."""
    assert kinds(write_recording(tmp_path, np.asarray(grid(2)), change=configured(n_env=1 << 24)))


def test_a_file_that_becomes_shorter(tmp_path: Path) -> None:
    """End the walk where the file ends now, and say so, instead of dying of SIGBUS."""
    path = write_recording(tmp_path, grid(2))
    source, problems = MappedFile(path), Problems()
    os.truncate(path, 4096)
    assert not scan(source, problems).finished
    assert problems.of(Kind.record) == ("the file became shorter while it was read",)
    assert "became shorter" in problems.skipped(Kind.digest)


@pytest.mark.parametrize("level", ["default", "run-to-run"])
def test_phases_that_differ_are_told_with_their_level(level: str, tmp_path: Path) -> None:
    """Say at which level states of both phases differ, since what to do depends on it."""
    path = write_recording(tmp_path, grid(2), elapsed_s=1.0, determinism=level, **WRITTEN["observer"])
    report = check([examine(path)], [load_rules("integrity-1")])
    (found,) = (one for one in report.findings if one.rule.id == "observer")
    assert found.found == f"timed and captured states differ at step 2, in 2 of 2 environments; level {level}"
    assert "capturing changed the states" in found.rule.do and "with --determinism" in found.rule.do


@pytest.mark.parametrize(("intervention", "differs"), [("reset@1", False), ("reset@2", True)])
def test_phases_may_differ_behind_an_intervention(intervention: str, differs: bool, tmp_path: Path) -> None:
    """Compare no state that the capture has changed by an intervention, which the timed phase does not make."""
    parts = WRITTEN["observer"] | {"change": configured(intervention=intervention)}
    path = write_recording(tmp_path, grid(2), elapsed_s=1.0, **parts)
    assert ("observer" in broken(path)) is differs
    observed = read_run(open_recording(path), 0.02).observed
    assert observed is True if differs else isinstance(observed, Missing)
