"""Recordings of one configuration that differ in how they were treated: the arms of a probe."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.groups import GroupKey, key_of
from gpusimbench.schemas.configuration import TELLING, RunConfiguration
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.initial import Given, Initial, drawn, initial_words, parse_initial
from gpusimbench.schemas.text import plural
from gpusimbench.schemas.treatment import Intervention, Vary, snapshot_name


@dataclass(frozen=True)
class Arms:
    """What was recorded of one configuration.

    key       what all arms have in common; of others than these its number of environments, treatment and what follows
              from them are empty. Where parameters vary, an environment keeps its own when it changes slot
    n_env     of the arms that are compared with each other
    plain     environments that begin alike, and are left alone
    varied    environments that begin differently, and are left alone; `spread` as in their configurations
    by_number the same with other numbers of environments
    otherwise the same, where environments begin otherwise, with how they begin
    treated   as `varied`, by kind of intervention
    continued a run that saved a snapshot, and one that began with the snapshot in a process of its own
    repeated  runs of one treatment, of each that has several
    runs      the first run of each treatment, by how it was treated in words
    others    arms of the same simulator, version, scene, options and level that stepped on another device
    failed    why arms are missing, by how they were to be treated
    """

    key: GroupKey
    n_env: int
    plain: tuple[Recording, ...]
    varied: tuple[Recording, ...]
    by_number: dict[int, Recording]
    otherwise: dict[Recording, Initial]
    treated: dict[str, Recording]
    continued: tuple[Recording, Recording] | None
    repeated: tuple[tuple[Recording, ...], ...]
    failed: dict[str, str]
    runs: dict[str, Recording]
    others: tuple[Arms, ...] = ()

    @property
    def version(self) -> str:
        """The version of the engine."""
        return self.key.version


def name_of(arms: Arms) -> str:
    """Simulator, version, level, device."""
    key = arms.key
    level = "" if key.determinism == "default" else f", determinism {key.determinism}"
    options = "".join(f", {name}={value}" for name, value in key.parsed_options.items())
    options += "".join(f", {name} {TELLING[name].words(value)}" for name, value in key.settings)
    return f"{key.simulator} {key.version}{level}{options} on {key.device}, {key.scene}"


def arms_of(recordings: Sequence[Recording]) -> list[Arms]:
    """The arms of each configuration among some recordings that were captured, in order of first appearance.

    Of copies of one run the first counts: that copies agree says nothing of another run.
    """
    found: dict[GroupKey, list[Recording]] = {}
    seen: set[str] = set()
    for recording in recordings:
        c = recording.configuration
        how = parse_initial(c.initial) if c.initial else None
        given = isinstance(how, Given) and how.step is None  # which no arm is
        if "capture" in c.phases and not given and _together(c) and recording.provenance.run_id not in seen:
            seen.add(recording.provenance.run_id)
            found.setdefault(_common(recording), []).append(recording)
    made = [_arms(key, alike) for key, alike in _without_followers(found).items()]
    elsewhere = gathered((_anywhere(arms.key), arms) for arms in made)
    return [
        replace(arms, others=tuple(o for o in elsewhere[_anywhere(arms.key)] if o.key.device != arms.key.device))
        for arms in made
    ]


def _anywhere(key: GroupKey) -> GroupKey:
    """What arms of several devices have in common; drivers and switches follow from the device."""
    return replace(key, device="", conditions="", switches="")


def _together(c: RunConfiguration) -> bool:
    # whether parameters of environments that vary change slots as their initial states do
    if not c.vary:
        return True
    vary, initial = Vary.parse(c.vary), drawn(c.initial)
    return (vary.shift, vary.but) == ((initial.shift, initial.but) if initial else (0, None))


def _common(recording: Recording) -> GroupKey:
    options = json.dumps(recording.configuration.options, sort_keys=True)
    key = key_of(recording)
    vary = recording.configuration.vary
    key = key.with_settings(initial="", vary=vary and str(Vary.parse(vary).usual), intervention="")
    return replace(key, n_env=0, warmup=0, timed_steps=0, layout="", origins="", options=options)


def _without_followers(found: dict[GroupKey, list[Recording]]) -> dict[GroupKey, list[Recording]]:
    """Joins configurations whose switches differ only where the engine itself sets them by the number of environments.

    Such a switch has one value for each number of environments. Genesis, for one, chooses how it divides its work
    (`para_level`) by that number: whether the result depends on the choice is what the probe asks.
    """
    families = gathered((replace(key, switches=""), key) for key in found)
    joined: dict[GroupKey, list[Recording]] = {}
    for keys in families.values():
        values: dict[str, dict[int, set[str]]] = {}
        for key in keys:
            numbers = {recording.configuration.n_env for recording in found[key]}
            for name, value in json.loads(key.switches or "{}").items():
                for n_env in numbers:
                    values.setdefault(name, {}).setdefault(n_env, set()).add(json.dumps(value))
        followers = {name for name, by_number in values.items() if all(len(one) == 1 for one in by_number.values())}
        for key in keys:
            switches = json.loads(key.switches or "{}")
            chosen = {name: value for name, value in switches.items() if name not in followers}
            joined.setdefault(replace(key, switches=json.dumps(chosen)), []).extend(found[key])
    return joined


def _arms(key: GroupKey, recordings: Sequence[Recording]) -> Arms:
    usual = Counter(r.configuration.n_env for r in recordings)
    n_env = max(usual, key=lambda n: (usual[n], n))
    good = [r for r in recordings if _ended(r) and not r.dropouts]
    failed = {_treatment(r): f"{r.status}: {r.reason}" for r in recordings if r not in good}
    alone = [r for r in good if not r.configuration.intervention and not r.configuration.snapshots]
    varied = _of_one_spread({r: initial for r in good if (initial := drawn(r.configuration.initial))})
    same = [r for r, initial in varied.items() if not initial.kind]
    usual_size = {r: initial for r, initial in varied.items() if r.configuration.n_env == n_env}
    treated = [r for r in same if r in usual_size and not r.configuration.snapshots]
    by_treatment = gathered((_treatment(recording), recording) for recording in good)
    return Arms(
        key,
        n_env,
        tuple(r for r in alone if not r.configuration.initial and r.configuration.n_env == n_env),
        tuple(r for r in same if r in alone and r.configuration.n_env == n_env),
        {r.configuration.n_env: r for r in reversed(same) if r in alone and r.configuration.n_env != n_env},
        {r: initial for r, initial in usual_size.items() if initial.kind},
        {done.name: r for r in reversed(treated) if (done := Intervention.of(r.configuration.intervention))},
        _continued(good),
        tuple(tuple(runs) for runs in by_treatment.values() if len(runs) > 1),
        {how: why for how, why in failed.items() if how not in map(_treatment, good)},
        {how: runs[0] for how, runs in by_treatment.items()},
    )


def _continued(good: Sequence[Recording]) -> tuple[Recording, Recording] | None:
    """A run and the first that continues one of its snapshots, by what is attached to it."""
    for later in good:
        how = parse_initial(later.configuration.initial) if later.configuration.initial else None
        if not isinstance(how, Given) or how.step is None:
            continue
        for run in good:
            data = run.attachment(snapshot_name(how.step)) if how.step in run.configuration.snapshots else None
            if data is not None and hashlib.sha256(data).hexdigest() == how.sha256:
                return run, later
    return None


def _of_one_spread(varied: dict[Recording, Initial]) -> dict[Recording, Initial]:
    # states that are drawn from another range are other states
    spreads = Counter(initial.spread for initial in varied.values())
    usual = max(spreads, key=lambda spread: (spreads[spread], spread), default=None)
    return {recording: initial for recording, initial in varied.items() if initial.spread == usual}


def _ended(recording: Recording) -> bool:
    # gates are there to fire where an environment was made to fail
    done = Intervention.of(recording.configuration.intervention)
    may_fail = done is not None and done.kind.poisons
    return recording.status == "complete" or (may_fail and recording.status == "invalid")


def _treatment(recording: Recording) -> str:
    c = recording.configuration
    saved = f"snapshot {c.snapshots[0]}" if c.snapshots else ""
    return " ".join(filter(None, (plural(c.n_env, "env"), initial_words(c.initial), c.intervention, saved)))
