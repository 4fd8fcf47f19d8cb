"""What gsb-info says of recordings: a document for each file, or JSON of all."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

from gpusimbench.evaluator.check.hardware import Hardware
from gpusimbench.evaluator.check.inspection import Array, CoTenancy, Inspection, Memory, Rate
from gpusimbench.evaluator.check.integrity.problem import REMARKS, Kind
from gpusimbench.evaluator.json_values import brief, document_of, dump, plain
from gpusimbench.evaluator.metrics.cotenants import Presence
from gpusimbench.evaluator.read.episodes import EpisodeCounts
from gpusimbench.evaluator.read.failing import ONLY_FAILING
from gpusimbench.evaluator.read.known_errors import PREFIX
from gpusimbench.evaluator.render.document import Block, Cell, Document, Facts, Table, Text, Tone, table
from gpusimbench.evaluator.render.numbers import scaled
from gpusimbench.evaluator.report.sections.problems import counted, failing_table
from gpusimbench.evaluator.results.timed_work import SHORT_S
from gpusimbench.evaluator.runs.memory import described
from gpusimbench.schemas import __version__
from gpusimbench.schemas.configuration import MAX_VIEW, TELLING, RunConfiguration
from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.initial import initial_words
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.provenance import REAL, Provenance, Simulation, engine_name
from gpusimbench.schemas.text import cut, ordinal, plural
from gpusimbench.schemas.vector import RESET_KEYS, RESET_SEEDS

_SOURCES = {
    "device": "NVML, whole device",
    "process": "NVML, this process",
    "allocator": "the engine's own",
}
_LONGEST = 600
"""Characters of one entry; a stranger's file may have more to say."""


_FIRST = (
    "status", "integrity", "CAUTION", "sha256", "recorded", "simulator", "scene", "size", *TELLING, "protocol",
    "determinism", "machine", "gpu 0", "throughput", "states", "episodes", "hashed", "failed", "not read", "gate",
    "LOST",
)  # fmt: skip
"""What is said without --all."""


def info_document(found: Inspection, *, every: bool = False) -> Document:
    """What a file is: who made it, of what, where, and what is in it; with `every`, all that it says of itself."""
    said = gathered((label, cut(" ".join(text.split()), _LONGEST)) for label, text in _entries(found))
    shown = [name for name in said if every or name in _FIRST or (name == "overflow" and found.overflowed)]
    pairs = tuple((name, Cell(said[name][0], notes=tuple(said[name][1:]), tone=_tone(name, found))) for name in shown)
    blocks: list[Block] = [Facts(pairs)]
    if found.failing and found.failing.failures:
        bits = found.simulation.overflow_bits if found.simulation else ()
        blocks.append(failing_table([("", found.failing, bits)]))
    if every:
        blocks.append(_arrays(found))
    else:
        blocks.append(Text(f"{len(said) - len(shown)} more lines, and every array: --all", Tone.QUIET))
    return Document(str(found.file), tuple(blocks))


def _tone(name: str, found: Inspection) -> Tone:
    if name in ("CAUTION", "LOST") or (name == "status" and found.status != "complete"):
        return Tone.BAD
    return Tone.WARNING if name in ("gate", "not read") else Tone.PLAIN


def _arrays(found: Inspection) -> Table:
    recorded = [array for array in found.arrays if array.shape[0]]
    columns = ("array", "step x env x item x component", "unit", "frame", "size")
    return table("arrays", "Recorded states", columns, [_columns(array) for array in recorded])


def dump_info(found: Sequence[Inspection], unreadable: Sequence[tuple[Place, GsbError]]) -> str:
    """A JSON document with an object for each file, those that are no recordings with their error."""
    files: list[Any] = [_file(one) for one in found]
    files += [{"file": str(path), "status": "unreadable", "reason": str(error)} for path, error in unreadable]
    return dump(document_of({"gpusimbench": __version__, "files": files}))


def _file(value: Any) -> Any:
    # not dataclasses.asdict, which follows a stranger's JSON to any depth
    if is_dataclass(value):
        return {f.name: _file(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, tuple):
        return [_file(item) for item in value]
    if isinstance(value, dict) and any(map(is_dataclass, value.values())):
        return {name: _file(item) for name, item in value.items()}
    return plain(value)


def _entries(found: Inspection) -> Iterator[tuple[str, str]]:
    # a label that comes again adds a line to the first
    cause = f" ({found.cause})" if found.cause else ""
    yield "status", f"{found.status}{cause}{': ' if found.reason else ''}{found.reason}"
    yield "integrity", _integrity(found)
    for problems in found.integrity.values():
        for problem in problems[:2]:
            yield "integrity", f"! {problem}"
        if len(problems) > 2:
            yield "integrity", f"! and {len(problems) - 2} more like it"
    if found.doubtful:
        yield "CAUTION", f"{', '.join(found.doubtful)} is not what was recorded; what follows from it may be wrong"
    for said in found.known_errors:
        yield "CAUTION", f"{PREFIX}{said}"
    yield "sha256", _content_hash(found)
    if found.provenance:
        yield from _who(found.provenance)
        yield from _what(found.provenance, found.simulation)
        yield from _where(found.provenance, found.simulation)
    yield from _how_long(found)
    yield from _inside(found)
    for reason in found.unread:
        yield "not read", reason


def _content_hash(found: Inspection) -> str:
    if not found.content_hash:
        return "of the content: none, there is no end record"
    proof = {Kind.digest.name, Kind.content_hash.name}  # without these, it is a text that anyone can write
    if not found.verified:
        return f"{found.content_hash}, as the file states it: not verified"
    if proof & {*found.integrity, *found.unchecked}:
        return f"{found.content_hash}, as the file states it: not confirmed by its content"
    return found.content_hash


def _integrity(found: Inspection) -> str:
    count = sum(len(problems) for kind, problems in found.integrity.items() if Kind[kind] not in REMARKS)
    if count:
        return f"{count} problem{'s' if count > 1 else ''}; gsb-check says what they mean"
    if not found.verified:
        return "not verified (--no-verify); records and CRCs that were read are whole"
    looked_at = ["records", "digests", "content hash"]
    if Kind.crc_missing.name not in found.integrity:
        looked_at.insert(1, "CRCs")
    if "capture" in found.hashes and not found.failing and Kind.state_hash.name not in found.unchecked:
        looked_at.append("state hashes")
    return f"whole and unchanged: {', '.join(looked_at)}"


def _who(p: Provenance) -> Iterator[tuple[str, str]]:
    recorder = plain(p.software.get("recorder"))
    recorder = recorder if isinstance(recorder, dict) else {}
    commit = str(recorder.get("commit") or "")
    modified = ", modified" if recorder.get("modified") else ""
    by = f"{recorder.get('name') or 'gpusimbench'} {recorder.get('version', '(version not recorded)')}"
    if not recorder:
        by = "a program that does not name itself"
    at = f", commit {commit[:12]}{modified}" if commit else ", commit not recorded" if recorder else ""
    yield "recorded", f"{p.created_utc} by {by}{at}"
    yield "command", " ".join(p.argv) or "not recorded"
    yield "run", f"{p.run_id}, number {p.configuration.run_index} of its set"


def _what(p: Provenance, s: Simulation | None) -> Iterator[tuple[str, str]]:
    c = p.configuration
    yield (
        "simulator",
        f"{engine_name(c.simulator, s)} {s.version} on {s.device}" if s else f"{c.simulator}, which was never built",
    )
    digest = str(brief(s.scene.get("sha256", "")))[:12] if s else ""
    model = ""
    if c.model:
        begins = f"begins in keyframe {c.keyframe}" if c.keyframe != "none" else "begins in the reference state"
        model = f"; a model file, which is attached; {begins}; actions {initial_words(c.actions)}"
    yield "scene", f"{c.scene} ({f'sha256 {digest}' if digest else 'without a description'}){model}"
    if c.simulator == REAL:
        times = f"every {c.dt:g} s, {c.steps + 1} times" if c.steps > 1 else f"at {c.dt:g} s"
        yield "size", f"{plural(c.n_env, 'trial')}, measured {times}"
    else:
        yield "size", f"{plural(c.n_env, 'environment')}, dt {c.dt:g} s, {_seed(c)}"
        for name, value in c.settings:
            yield name, ": ".join(filter(None, (TELLING[name].words(value), TELLING[name].note)))
        yield "protocol", "; ".join(_protocol(c))
        yield "determinism", c.determinism + (" (the engine as it ships)" if c.determinism == "default" else "")
    given = c.options
    if s:
        yield "options", _pairs(s.options, given) or "none"
        yield "switches", _pairs(s.switches, {}) or "none"
        if s.remarks:
            yield "remarks", "; ".join(s.remarks)
        if s.deviations:
            yield "deviations", ", ".join(d.parameter for d in s.deviations) + " (why: --json)"
    elif given:
        yield "options", _pairs(given, given)


def _protocol(c: RunConfiguration) -> Iterator[str]:
    if "timed" in c.phases:
        yield f"{c.warmup} warm-up and {c.timed_steps} timed steps"
    if "capture" in c.phases:
        kept = "each" if c.stride == 1 else f"every {ordinal(c.stride)}"
        if c.keep:
            kept = f"those of failing environments alone ({c.keep})"
        begin = f" from step {c.first_step} on" if c.first_step else ""
        steps = "an unannounced number of captured steps" if c.is_open else plural(c.captured_steps, "captured step")
        yield f"{steps}{begin}, {kept} kept"


def _pairs(values: dict[str, Any], given: dict[str, str]) -> str:
    return ", ".join(f"{name}={brief(value)}{' (given)' if name in given else ''}" for name, value in values.items())


def _where(p: Provenance, s: Simulation | None) -> Iterator[tuple[str, str]]:
    host = {name: brief(value) for name, value in p.host.items()}
    if host:
        threads = f"{host.get('usable_threads', '?')} of {host.get('threads', '?')} threads"
        memory = f", {scaled(host['memory_bytes'], 'B')}" if isinstance(host.get("memory_bytes"), int) else ""
        yield "machine", f"{host.get('cpu', 'processor not told')}, {threads}{memory}"
        yield "system", f"{host.get('system', '?')} {host.get('kernel', '')}, {host.get('libc', '')}"
    for number, told in enumerate(p.gpus):
        gpu = {name: brief(value) for name, value in told.items()}
        used = "" if s is None or s.device == gpu.get("name") else ", which the simulator does not step on"
        memory = f", {scaled(gpu['memory_bytes'], 'B')}" if isinstance(gpu.get("memory_bytes"), int) else ""
        yield f"gpu {number}", f"{gpu.get('name', 'name not told')}{memory}, driver {gpu.get('driver', '?')}{used}"
    packages = p.software.get("packages")
    versions = {"Python": p.software.get("python", "?"), **(packages if isinstance(packages, dict) else {})}
    yield "software", ", ".join(f"{name} {brief(version)}" for name, version in versions.items())
    if p.environment:
        yield "variables", ", ".join(f"{name}={value}" for name, value in p.environment.items())


def _how_long(found: Inspection) -> Iterator[tuple[str, str]]:
    if found.phases:
        yield "phases", ", ".join(f"{name} {seconds:.3g} s" for name, seconds in found.phases.items())
    if found.timed or found.timed_missing:
        yield "throughput", _rate(found.timed) if found.timed else f"none: {found.timed_missing}"
    if found.captured or found.captured_missing:
        yield "capture", _rate(found.captured) if found.captured else f"no rate: {found.captured_missing}"
    if found.clocks:
        yield (
            "clocks",
            "intervals x steps: " + ", ".join(f"{name} {n}x{steps}" for name, (n, steps) in found.clocks.items()),
        )
    for source, memory in found.memory.items():
        yield "memory", _memory(source, memory)
    for source, hardware in found.hardware.items():
        yield "hardware", f"{source}: {_hardware(hardware)}"
    if found.co_tenants:
        yield "co-tenants", _co_tenants(found.co_tenants)


def _rate(rate: Rate) -> str:
    again = f", timed {rate.times} times" if rate.times > 1 else ""
    window = f"{rate.n_env} x {rate.steps} steps, from step {rate.first_step:,}{again}"
    short = f" (< {SHORT_S:g} s)" if rate.seconds < SHORT_S else ""
    return f"{rate.env_steps_per_s:,.0f} env-steps/s: {window}, in {rate.seconds:.4g} s{short}"


def _seed(configuration: RunConfiguration) -> str:
    seeds, keys = (configuration.options.get(name) for name in (RESET_SEEDS, RESET_KEYS))
    if keys is not None:
        return f"rng {keys}"
    return f"seed {configuration.seed}" if seeds is None else f"seeds {seeds}"


def _co_tenants(found: CoTenancy) -> str:
    if found.signs:
        return f"another process was on the GPU ({described(found.signs)})"
    if found.presence == Presence.NONE.value:
        return "none: NVML listed no other process on the GPU at any checkpoint or in the timed phase"
    return "unknown: nothing in this file tells whether another process was on the GPU"


def _memory(source: str, memory: Memory) -> str:
    baseline = "no baseline" if memory.baseline is None else f"baseline {scaled(memory.baseline, 'B')}"
    total = f" of {scaled(memory.total, 'B')}" if memory.total else ""
    what = _SOURCES.get(source.rpartition("/")[2], "")
    return f"{source}{f' ({what})' if what else ''}: {baseline}, peak {scaled(memory.peak, 'B')}{total}"


_QUANTITIES = {
    "sm_clock_mhz": ("SM clock", "MHz", 1.0),
    "memory_clock_mhz": ("memory clock", "MHz", 1.0),
    "power_mw": ("power", "W", 1e-3),
    "temperature_c": ("temperature", "°C", 1.0),
    "utilisation_percent": ("utilisation", "%", 1.0),
    "other_processes": ("other processes", "", 1.0),
    "cpu_clock_mhz": ("CPU clock", "MHz", 1.0),
    "other_cpus": ("other processes", "CPUs", 1.0),
}
"""Fields of a reading in words, with a unit and the factor to it."""


def _hardware(found: Hardware) -> str:
    gap = "" if found.longest_gap_s is None else f", at most {found.longest_gap_s:.2g} s apart"
    over = f"of the timed phase{gap}" if found.timed else "of all phases"
    parts = [f"{plural(found.timed or found.readings, 'reading')} {over}"]
    for name, (least, mean, most) in found.values.items():
        word, unit, factor = _QUANTITIES[name]
        spread = "" if least == most else f" ({least * factor:.4g} to {most * factor:.4g})"
        parts.append(f"{word} {mean * factor:.4g}{f' {unit}' if unit else ''}{spread}")
    if found.reasons is not None:
        held = ", ".join(f"{reason} in {share:.0%}" for reason, share in found.reasons.items())
        parts.append(f"reasons for lower clocks: {held or 'none'}")
    return "; ".join([*parts, *(f"not known: {why}" for why in found.not_known)])


def _episodes(counts: EpisodeCounts) -> str:
    said = f"{counts.ended:,} ended ({counts.terminated:,} terminated, {counts.truncated:,} truncated)"
    if counts.ended:
        said += f", mean length {counts.mean_length:.4g} steps, mean return {counts.mean_return:.4g}"
    return f"{said}; {counts.cut:,} cut by a reset or the end of the recording"


def _items(simulation: Simulation | None) -> dict[str, tuple[str, ...]]:
    """The names of the bodies or joints of each group of states."""
    return {field.group: field.items for field in (simulation.fields if simulation else ()) if any(field.items)}


def _inside(found: Inspection) -> Iterator[tuple[str, str]]:
    recorded = [array for array in found.arrays if array.shape[0]]
    if recorded:
        size = scaled(sum(array.bytes for array in recorded), "B")
        kinds = " and ".join(dict.fromkeys(array.dtype for array in recorded))
        groups = ", ".join(dict.fromkeys(array.name.partition("/")[0] for array in recorded))
        yield "states", f"of {groups}, in {kinds}, at {plural(recorded[0].shape[0], 'step')}: {size}"
    elif found.arrays:
        failing = found.provenance is not None and found.provenance.configuration.keep
        fields = ", ".join(array.name for array in found.arrays)
        yield "states", ONLY_FAILING if failing else f"none; {fields} could be captured"
    for group, items in _items(found.simulation).items():
        yield "names", f"{group}: {', '.join(items)}"
    if found.episodes is not None:
        yield "episodes", _episodes(found.episodes)
    if found.program:
        counts = [f"{name} ({plural(count, 'update')})" for name, count in found.program.items()]
        yield "hashed", f"arrays of the program: {', '.join(counts)}"
    if found.failing and found.provenance:
        yield "failed", counted(found.failing, found.provenance.configuration.n_env)
    for array in found.actions:
        yield "actions", f"{array.name}: {scaled(array.stored_bytes, 'B')}"
    for phase, names in found.counters.items():
        yield "counted", f"{phase}: {', '.join(names)}"
    if found.hashes:
        yield "hashes", ", ".join(f"{phase} at {plural(count, 'step')}" for phase, count in found.hashes.items())
    for gate in found.gates:
        yield "gate", gate
    if found.overflowed is not None:
        yield "overflow", "; ".join(found.overflowed) or "no buffer was run into, by the engine's word"
    for lost in found.dropouts:
        yield "LOST", lost
    if found.view:
        shown = ", ".join(map(str, found.view[:MAX_VIEW]))
        yield "view", f"environment {shown}; for Foxglove, Lichtblick and rerun, which take the file as it is"
    yield "attached", ", ".join(found.attachments) or "nothing"
    if found.container:
        c = found.container
        chunks = ", ".join(f"{count} {name}" for name, count in c.chunks.items()) or "none"
        size, unpacked, stored = (scaled(count, "B") for count in (c.bytes, c.unpacked_bytes, c.stored_bytes))
        yield "file", f"{size}; chunks: {chunks}, {unpacked} in {stored}; by {c.library or 'a tool without a name'}"


def _columns(array: Array) -> tuple[str, ...]:
    packed = f" in {scaled(array.stored_bytes, 'B')}" if any(array.encodings) else ""
    shape = "x".join(map(str, array.shape))
    return array.name, shape, array.unit, array.frame, f"{scaled(array.bytes, 'B')}{packed}"
