"""What gsb-diff says below its verdict: what was compared, and the first difference."""

from __future__ import annotations

from gpusimbench.evaluator.diff import words
from gpusimbench.evaluator.diff.result import Contacts, Difference, Divergence, Growth, Side
from gpusimbench.evaluator.diff.verdict import both_of, equal_before, pair_of, step_of
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.document import Facts, facts
from gpusimbench.evaluator.render.numbers import length
from gpusimbench.schemas.text import plural

_ITEMS, _FIELDS, _NAMES, _CHANGES, _CLASSES = 6, 8, 4, 4, 3
_JOINTS = "/qpos "  # a field of several units is in parts, such as "joints/qpos [m]"
Pairs = list[tuple[str, str]]
Labels = tuple[int, ...]


def brief(found: Difference, *, every: bool) -> Facts:
    """Both sides, what was compared and the first difference; and in short, unless it follows at length, the rest."""
    pairs: Pairs = [("a", _side(found.a)), ("b", _side(found.b)), ("compared", _compared(found))]
    if found.program:
        pairs += words.pairs(found.program)
    if found.first:
        pairs += _first(found, found.first)
        if every:
            pairs += _contacts(found, found.first)
        else:
            pairs += _apart(found)
            if found.compared.n_env > 1:
                pairs.append(("trajectories", _trajectories(found)))
    if not every or not found.settings:
        pairs += _settings(found)
    return facts(*pairs)


def _side(side: Side) -> str:
    return f"{side.label}, env{'s' if len(side.envs) > 1 else ''} {words.ranges(list(side.envs))}: {side.file}"


def _compared(found: Difference) -> str:
    compared = found.compared
    parts = [words.counted(len(compared.fields), "field"), words.counted(compared.n_env, "pair") + " of envs"]
    if steps := compared.state_steps:
        parts.append(f"{words.counted(steps.count, 'recorded state')} from step {steps.first} to {steps.last}")
    hashes = []
    if steps := compared.hash_steps:
        hashes.append(f"{words.counted(steps.count, 'step')} from step {steps.first} to {steps.last}")
    if compared.timed_steps:
        hashes.append(f"{words.counted(compared.timed_steps.count, 'step')} of the timed phase")
    return ", ".join(parts) + (f"; by 64-bit hashes: {', '.join(hashes)}" if hashes else "")


def _first(found: Difference, first: Divergence) -> Pairs:
    said = step_of(found, first) + equal_before(first)
    if found.compared.n_env > 1:
        pairs = f"{first.envs:,} of {plural(found.compared.n_env, 'pair', spec=',')} of envs differ at that step"
        said += f"; {pairs}, first {pair_of(found, first)}"
    label = "states differ" if found.other_program else "first at"
    return [(label, said), *_where(found, first)]


def _where(found: Difference, first: Divergence) -> Pairs:
    state = first.state
    if first.phase == "timed":
        return [("body and field", "not known: only hashes of the timed phase are recorded, no states")]
    if state is None and found.compared.state_steps is None:
        return [("body and field", "not known: the recordings have no states of a common step, only hashes")]
    if state is None:
        return [("body and field", "not known: all recorded states are equal again")]
    pairs: Pairs = []
    if state.step != first.step_a:
        no_state = f"not known: no state of step {first.step_a} was recorded (record with --stride 1)"
        pairs.append(("body and field", f"{no_state}; the differences at step {state.step} ({state.time:g} s):"))
    every = len(state.fields) == len(found.compared.fields) > 1
    fields = f"all {len(state.fields)}" if every else words.names(state.fields, _FIELDS)
    return [
        *pairs,
        ("fields", fields),
        *([("items", words.names(state.items, _ITEMS))] if any(state.items) else []),
        ("first number", both_of(state.number)),
    ]


def _contacts(found: Difference, first: Divergence) -> Pairs:
    sides = (("a", first.contacts_a), ("b", first.contacts_b))
    if not (first.contacts_a or first.contacts_b):
        return []
    counted = [_counted(contacts) for _, contacts in sides]
    if found.one_recording:
        return [("contacts then", counted[0])]
    return [("contacts then", "; ".join(f"{name} {said}" for (name, _), said in zip(sides, counted, strict=True)))]


def _counted(contacts: Contacts | None) -> str:
    return f"mean {contacts.mean:.4g} per env, max {contacts.max:g}" if contacts else "not counted"


def _apart(found: Difference) -> Pairs:
    """How far bodies lie apart; of mechanisms whose joints alone are recorded, how far these do."""
    if not isinstance(found.growth, Missing):
        return _growth(found.growth)
    joints = [f for f in found.compared.fields if _JOINTS in f"{f.field} " and f.max_distance is not None]
    if not joints:
        return [("growth", f"not known: {found.growth.reason}")]
    listed = " and ".join(f"{words.amount(f.max_distance, f.unit)} ({f.field.partition(' ')[0]})" for f in joints)
    return [("joints", f"up to {listed} apart, over all recorded states")]


def _growth(growth: Growth) -> Pairs:
    last = next((row for row in reversed(range(len(growth.times))) if growth.largest[row] is not None), None)
    parts = []
    if last is not None:
        parts.append(f"bodies up to {length(growth.largest[last])} apart at {growth.times[last]:g} s")
    if growth.fallen:
        fell = f"without {plural(growth.fallen, 'body', 'bodies')} that fell off the board"
        parts.append(fell if growth.max_not_fallen else "all of which fell off the board")
    parts += reached(growth)
    if not isinstance(growth.fit, Missing) and not growth.fit.why_no_rate:
        parts.append(f"exponential rate {growth.fit.rate:.3g} /s")
    if growth.not_finite_from is not None:
        parts.append(f"without positions that are not finite, first at step {growth.not_finite_from}")
    return [("growth", ", ".join(parts))]


def _trajectories(found: Difference) -> str:
    splits = found.splits
    if splits.classes_missing:
        return f"equal pairs of envs: {words.changes(splits.agreeing, _CHANGES)}"
    count, listed = classes_of(found, splits.classes_a or (), splits.classes_b or (), _CLASSES)
    return f"{count}: {' | '.join(listed)}" if listed else f"{count}, no two envs are equal"


def reached(growth: Growth) -> list[str]:
    """When the largest distance is 1 mm, and 1 cm."""
    # a body that fell off may lie further from the same body elsewhere
    never = "never reached on the board" if growth.fallen and growth.max_not_fallen else "never reached"
    return [
        f"{size} {never if when is None else f'reached by {when:g} s'}"
        for size, when in (("1 mm", growth.to_1mm), ("1 cm", growth.to_1cm))
    ]


def _settings(found: Difference) -> Pairs:
    if found.settings:
        deciding = found.settings[: len(found.settings) - found.other_packages]
        names = [words.names([setting.name for setting in deciding], _NAMES)] if deciding else []
        if found.other_packages:
            other = "other installed package" if deciding else "installed package"
            names.append(words.counted(found.other_packages, other))
        return [("settings", f"{words.differ(len(found.settings))}: {'; and '.join(names)}")]
    if found.one_recording:
        return []
    if found.described:
        return [("settings", "the same configuration, versions, options and machine")]
    same = "the same configuration and machine"
    return [("settings", f"{same}; neither recording states its versions and options, so they are not compared")]


def classes_of(found: Difference, of_a: Labels, of_b: Labels, most: int) -> tuple[str, list[str]]:
    """How many classes there are, and the members of the largest; no members where each environment is its own class.

    of_a, of_b  class of each environment of either side
    most        how many classes are listed
    """
    members: dict[int, tuple[list[int], list[int]]] = {}
    for side, envs, labels in ((0, found.a.envs, of_a), (1, found.b.envs, of_b)):
        for env, label in zip(envs, labels, strict=True):
            members.setdefault(label, ([], []))[side].append(env)
    count = f"{len(members):,} {'class' if len(members) == 1 else 'classes'}"
    if len(members) == len(of_a) + len(of_b):
        return count, []
    largest = sorted(members.values(), key=lambda envs: -len(envs[0]) - len(envs[1]))
    listed = [_members(a, b, found.one_recording) for a, b in largest[:most]]
    if len(largest) > most:
        listed.append(f"and {len(largest) - most:,} more, which --json lists")
    return count, listed


def _members(a: list[int], b: list[int], one_recording: bool) -> str:
    if one_recording:
        return f"env{'s' if len(a) + len(b) > 1 else ''} {words.ranges(sorted(a + b))}"
    sides = (f"{name} {words.ranges(envs)}" for name, envs in (("a", a), ("b", b)) if envs)
    return "; ".join(sides)
