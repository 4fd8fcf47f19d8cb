"""A recording's own configuration, to be run again here.

Of a recording its configuration is taken and nothing else: names and numbers, which pass the same checks as a user's
arguments. No code, model or path of it is used. The steps and environments that it asks for must be those that it shows
to have been done (recorder.sets.traces). Options leave no traces, and may ask for any amount of work, memory and
threads in a step: a time limit and a cage (recorder.process.cage) bound that.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from gpusimbench.recorder.plan import free_bytes
from gpusimbench.recorder.probes.host import memory_bytes
from gpusimbench.recorder.process.cage import Cage, gib
from gpusimbench.recorder.run.vary import attachment, variation
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.sets.finished import outcome_of, run_end
from gpusimbench.recorder.sets.traces import check_traces, content_bytes, least_memory, peak_bytes, ran_s
from gpusimbench.schemas.checks import Budget
from gpusimbench.schemas.configuration import TELLING, RunConfiguration
from gpusimbench.schemas.digest import attachment_name, content_hash
from gpusimbench.schemas.errors import DamagedRecording, RecordingError, UsageError
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.initial import GIVEN, Given, drawn
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.model_files import COMPRESSED, MODEL, plain
from gpusimbench.schemas.provenance import LOGGED, PROVENANCE, REAL, SCENE, SIMULATION, Provenance, ReplayOf, Simulation
from gpusimbench.schemas.text import cut, ordinal, plural
from gpusimbench.schemas.treatment import CONTROLS, VARIED, FromFile, snapshot_name

CODE_OPTIONS = ("module",)
"""Options that name code to be loaded: never taken from a file."""

_SHOWN_CHARACTERS = 600


@dataclass(frozen=True)
class ReplaySource:
    """A recording that can be replayed.

    path           of the file
    run_id         of its run
    content_hash   of the recording
    configuration  as recorded
    fields         layout of its states
    scene_sha256   identity of its scene
    ran_s          how long the run took where it was made [s]; None where it does not say
    cage           what a replay may take of a machine
    digests        of its attachments and streams, which its content hash is made of [hex]
    """

    path: Path
    run_id: str
    content_hash: str
    configuration: RunConfiguration
    fields: tuple[StateField, ...]
    scene_sha256: str
    ran_s: float | None
    cage: Cage
    digests: Mapping[str, str]


def read_source(path: Path, *, allow_model: bool = False) -> ReplaySource:
    """What a recording says of itself.

    allow_model  the model files that it carries may be loaded

    RecordingError where the file is damaged, UsageError where what it holds is nothing that can be replayed.
    """
    try:
        return _read(Container(path), path, allow_model)
    except RecordingError as error:
        said = shown(str(error))
        raise type(error)(said if str(path) in said else f"{path}: {said}") from None


def _read(container: Container, path: Path, allow_model: bool) -> ReplaySource:
    end = run_end(container)
    if end is None:
        raise DamagedRecording("incomplete: a run that has no end cannot be replayed")
    status = outcome_of(end).status
    text, scene = container.attachment(PROVENANCE), container.attachment(SCENE)
    if text is None:
        raise DamagedRecording("it says nothing of where it comes from")
    budget = Budget()
    provenance = Provenance.from_json(text, budget)
    c = provenance.configuration
    if c.simulator == REAL:
        raise UsageError(f"{path} holds measured trials: no simulator can replay them")
    if c.model and not allow_model:
        raise UsageError(
            f"{path} carries a model file of its author's, which the engine would parse; add --allow-model where you "
            "trust its author"
        )
    if status not in ("complete", "invalid"):
        why = shown(end.reason) or "it does not say why"
        raise UsageError(f"{path} cannot be replayed: its run {status}, so that it shows no whole run: {why}")
    described = container.attachment(SIMULATION)
    if described is None:
        raise DamagedRecording("it does not say what its simulator was")
    simulation = Simulation.from_json(described, budget)
    if simulation.fresh_start == LOGGED:
        raise UsageError(
            f"{path} cannot be replayed: a program logged it that no simulator of gsb-record stands for; gsb-audit "
            "--command runs the program again"
        )
    if scene is None:
        raise DamagedRecording("it does not say what its scene was")
    scene_hash = hashlib.sha256(scene).hexdigest()
    if simulation.scene.get("sha256") != scene_hash:
        raise DamagedRecording("its scene is not the one that its simulator was given")
    for name, attached in ((PROVENANCE, text), (SCENE, scene), (SIMULATION, described)):
        if end.digests.get(attachment_name(name)) != hashlib.sha256(attached).hexdigest():
            raise DamagedRecording(f"{name} was changed since the recording was made")
    if content_hash(dict(end.digests), status, end.reason) != end.content_hash:
        raise DamagedRecording("the end record was changed since the recording was made")
    check_traces(container, c, simulation.fields)
    cage = Cage(peak_bytes(container, end.peak_rss_bytes), content_bytes(container, c, simulation.fields))
    return ReplaySource(
        path, provenance.run_id, end.content_hash, c, simulation.fields, scene_hash, ran_s(container), cage,
        dict(end.digests),
    )  # fmt: skip


def replayed(
    source: ReplaySource,
    *,
    options: Mapping[str, str],
    phases: tuple[str, ...] | None,
    timeout: float,
    compression: str,
) -> RunConfiguration:
    """What is to be run: as recorded, but for these.

    options  that the user has otherwise; others stay as recorded
    phases   None: as recorded

    The time limit and the compression are no part of what a run computes, and are the user's. So is the view, and none
    is asked for here. UsageError where the
    recording names code to be loaded and the user does not, and for a phase that it has not.
    """
    c = source.configuration
    for name in CODE_OPTIONS:
        if c.options.get(name) and name not in options:
            named = shown(c.options[name])
            raise UsageError(
                f"{source.path} has --option {name}={named}, which names code to be loaded; that is never taken from a "
                f"file: say --option {name}={named} yourself if it is yours"
            )
    if phases is not None and not set(phases) <= set(c.phases):
        raise UsageError(f"--phases {','.join(phases)}: {source.path} has only {','.join(c.phases)}")
    return replace(
        c, run_index=0, options={**c.options, **options}, phases=c.phases if phases is None else phases,
        timeout=timeout, compression=compression, view=(),
    )  # fmt: skip


def begun(
    source: ReplaySource, configuration: RunConfiguration, from_step: int | None
) -> tuple[RunConfiguration, dict[str, bytes]]:
    """How a replay begins, as the recording did or at a snapshot that it has, and the files that it is given for that.

    from_step  the snapshot's step; None: as the recording did

    UsageError where there is no such snapshot, DamagedRecording where what is attached is not what it was.
    """
    c, path = configuration, source.path
    model = {MODEL: _archive(source)} if c.model else {}
    if FromFile.parse(c.actions):
        model[CONTROLS] = _attached(source, CONTROLS)
    if from_step is None:
        if drawn(c.initial) or not c.initial:
            return c, model
        return c, {**model, GIVEN: _attached(source, GIVEN)}
    if from_step not in c.snapshots:
        has = ", ".join(map(str, c.snapshots)) or "none: gsb-record --snapshot STEP saves them"
        raise UsageError(f"{path} has no snapshot of step {from_step}; it has {has}")
    if "capture" not in c.phases:
        raise UsageError("--from captures states from a step on, and --phases has no capture")
    if from_step % c.stride or from_step >= c.steps:
        raise UsageError(
            f"{path} has states of every {ordinal(c.stride)} step up to {c.steps}: --from {from_step} must be one "
            "of these steps, and not the last"
        )
    initial = drawn(c.initial)
    if initial is not None and initial.shift:
        raise UsageError(
            f"{path} began with --initial {c.initial}: a run from a snapshot on does not know that actions were "
            "shifted, too; replay it without --from"
        )
    data = _attached(source, snapshot_name(from_step))
    how = Given(hashlib.sha256(data).hexdigest(), from_step)
    later = tuple(step for step in c.snapshots if step > from_step)
    return replace(c, initial=str(how), phases=("capture",), snapshots=later), {**model, GIVEN: data}


def _archive(source: ReplaySource) -> bytes:
    name = COMPRESSED if attachment_name(COMPRESSED) in source.digests else MODEL
    try:
        return plain(name, _attached(source, name))
    except DamagedRecording as error:
        raise DamagedRecording(f"{source.path}: {str(error).removeprefix(f'{source.path}: ')}") from None


def _attached(source: ReplaySource, name: str) -> bytes:
    data = Container(source.path).attachment(name)
    if data is None or hashlib.sha256(data).hexdigest() != source.digests.get(attachment_name(name)):
        raise DamagedRecording(f"{source.path}: {name} is missing, or was changed since the recording was made")
    return data


def origin(source: ReplaySource, configuration: RunConfiguration) -> ReplayOf:
    """What a replay's recording says of the one that it is a replay of."""
    was = source.configuration
    changed = {
        f"options.{name}": was.options.get(name, "")
        for name, value in configuration.options.items()
        if was.options.get(name) != value
    }
    if configuration.phases != was.phases:
        changed["phases"] = ",".join(was.phases)
    if configuration.initial != was.initial:
        changed["initial"] = was.initial
    return ReplayOf(source.run_id, source.content_hash, changed)


def check_scene(source: ReplaySource, scene: Scene) -> None:
    """UsageError where the scene of that name is another one here."""
    if scene.sha256() != source.scene_sha256:
        raise UsageError(
            f"{source.path} cannot be replayed: scene '{scene.name}' is another one here, with SHA-256 "
            f"{scene.sha256()[:12]}; the recording's has {source.scene_sha256[:12]}"
        )


def check_varied(source: ReplaySource, configuration: RunConfiguration, scene: Scene) -> None:
    """UsageError where environments would have other parameters here than the recording says that they had."""
    c = configuration
    drawn_here = variation(c.vary, scene, n_env=c.n_env, seed=c.seed)
    if drawn_here is not None and _attached(source, VARIED) != attachment(drawn_here):
        raise UsageError(f"{source.path} cannot be replayed: --vary {c.vary} draws other parameters here than it has")


def check_room(source: ReplaySource, runs: int, folder: Path) -> None:
    """UsageError where this machine has not the memory or the disk for what the recording asks for, at the least."""
    may, why = source.cage.memory(memory_bytes())
    wanted = least_memory(source.configuration, source.fields)
    if wanted > may:
        raise UsageError(
            f"{source.path} cannot be replayed: the states of {source.configuration.n_env} environments alone are "
            f"{gib(wanted)}, and a replay may take {gib(may)} of memory, {why}"
        )
    free, wanted = free_bytes(folder), runs * source.cage.content_bytes
    if free is not None and wanted > free:
        raise UsageError(
            f"{source.path} cannot be replayed: {runs} recordings of it have about {gib(wanted)}, and {folder} has "
            f"{gib(free)} free; choose another folder with --out, or fewer --runs"
        )


def announcement(source: ReplaySource, configuration: RunConfiguration) -> str:
    """One line: what is going to be run, and how long it took where it was recorded."""
    c = configuration
    steps = []
    if "timed" in c.phases:
        steps.append(f"{c.warmup} + {c.timed_steps} timed steps")
    if "capture" in c.phases:
        from_step = f" from step {c.first_step} on" if c.first_step else ""
        steps.append(f"{c.captured_steps} captured steps{from_step}")
    if "import" in c.phases:
        steps.append("the model's import")
    given = "".join(f", {name}={value}" for name, value in c.options.items())
    level = "" if c.determinism == "default" else f", determinism {c.determinism}"
    begins = "".join(f", {name} {TELLING[name].words(value)}" for name, value in c.settings)
    took = "" if source.ran_s is None or source.ran_s > 1e9 else f"; a run took {source.ran_s:.1f} s there"
    line = (
        f"replay of run {source.run_id[:8]}, content {source.content_hash[:12]}: {c.simulator}{given}{level}, "
        f"{c.scene}, {plural(c.n_env, 'env')}, dt {c.dt:g} s, seed {c.seed}{begins}, {' and '.join(steps)}{took}"
    )
    return shown(line)


def shown(text: str) -> str:
    """A file's text for a terminal: no control characters, and not for ever."""
    short = cut(text, _SHOWN_CHARACTERS)
    return "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in short)
