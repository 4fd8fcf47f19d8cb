"""What gsb-diff says first: the verdict in a sentence, what was compared, and the first difference."""

from __future__ import annotations

from gpusimbench.evaluator.diff import words
from gpusimbench.evaluator.diff.program_parts import is_action
from gpusimbench.evaluator.diff.result import Contacts, Difference, DiffVerdict, Divergence, Growth, Number, Side
from gpusimbench.evaluator.diff.words import WITHOUT_UNIT
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.document import Facts, Text, Tone, facts
from gpusimbench.evaluator.render.numbers import length
from gpusimbench.schemas.fields import ENV
from gpusimbench.schemas.text import plural
from gpusimbench.schemas.vector import IMAGE_HASH


def verdict_of(found: Difference, who: str = "") -> Text:
    """The first line of what gsb-diff says.

    who  the two, in words; empty: two recordings, or what is compared of one
    """
    who = who or _who(found)
    part = bool(found.compared.left_out or found.lost)
    if found.verdict is DiffVerdict.IDENTICAL:
        if part:
            return Text(f"{who} are equal bit for bit as far as compared; not everything was compared.", Tone.WARNING)
        return Text(f"{who} are bit-identical.", Tone.GOOD)
    if found.verdict is DiffVerdict.WITHIN_RESOLUTION:
        far = " as far as compared" if part else ""
        return Text(f"{who} are equal within the resolution{far}; their bits cannot be compared.", Tone.WARNING)
    if found.program is not None and found.program.first is not None:
        return Text(words.sentence(found.program, found.program.first, who, found.a.dt), Tone.BAD)
    assert found.first is not None
    since = _since(found, found.first)
    if found.same_up_to_env_order:
        return Text(f"{who} are equal up to the order of environments; env by env, they {since}.", Tone.BAD)
    if found.same_up_to_body_order and any(field.different for field in found.compared.fields):
        of = "environments and bodies" if found.bodies_of_other_envs else "bodies"
        equal = f"are equal up to the order of {of} at all recorded states"
        return Text(f"{who} {equal}; body by body, they {since}.", Tone.BAD)
    if found.same_rotations:
        return Text(f"{who} have the same rotations, some as quaternions of the other sign; they {since}.", Tone.BAD)
    return Text(f"{who} {since}{_place(found, found.first)}.{_whose(found, found.first)}", Tone.BAD)


def step_of(found: Difference, first: Divergence) -> str:
    """The first step that differs, with its time; of which phase, where the capture is known beside it."""
    step = f"{first.step_a}" if first.step_a == first.step_b else f"{first.step_a} of a, {first.step_b} of b"
    return f"step {step} ({first.time:g} s){' of the timed phase' if _beside_capture(found, first) else ''}"


def gap_before(first: Divergence) -> bool:
    """Whether steps just before the first difference are unknown, so that the sides may have parted there."""
    return first.after_step is not None and first.after_step < first.step_a - 1


def equal_before(first: Divergence) -> str:
    """Up to which step the two are equal, to be added to the first step that differs; empty where none is before it."""
    if first.after_step is None:
        return ""
    return f"; equal up to step {first.after_step}{', no step in between is known' if gap_before(first) else ''}"


def pair_of(found: Difference, first: Divergence) -> str:
    """The first pair of environments that differs."""
    if found.one_recording or first.env_a != first.env_b:
        return f"between env {first.env_a} and env {first.env_b}"
    return f"in env {first.env_a}{', where an episode begins' if first.begins_episode else ''}"


def apart(number: Number, *, named: bool = False) -> str:
    """How far two numbers are apart; `named` as in in_ulps of words."""
    if number.field.startswith(f"{ENV}/") and number.field.endswith(IMAGE_HASH):
        return "hashes of images that differ"
    parts = [
        words.in_ulps(number, named=named),
        "same rotation, other sign" if number.other_sign else "",
        words.amount(number.distance, number.unit) if number.distance is not None else "",
    ]
    return ", ".join(part for part in parts if part)


def place_of(number: Number) -> str:
    """Field, body and component of a number; of an array without bodies, such as "observation[5]"."""
    if not number.item:
        return f"{number.field}[{number.component}]" if number.component else number.field
    return f"{number.field} of {words.name(number.item)}, {words.name(number.component)}"


def both_of(number: Number) -> str:
    """A pair of numbers: where, both values, their bits, and how far they are apart."""
    unit = "" if number.unit in WITHOUT_UNIT else f" {number.unit}"
    values = f"{number.a} and {number.b}{unit} ({number.hex_a}, {number.hex_b})"
    resolution = ""
    if number.resolution is not None:
        resolution = f"; up to {words.amount(number.resolution, number.unit)} counts as equal"
    return f"{place_of(number)}: {values}: {apart(number, named=True)}{resolution}"


def _who(found: Difference) -> str:
    a, b = found.a.envs, found.b.envs
    if found.one_recording:
        return f"Env {a[0]} and env {b[0]} of the recording" if len(b) == 1 else "The environments of the recording"
    return f"Env {a[0]} of a and env {b[0]} of b" if len(a) == len(b) == 1 else "The two recordings"


def _since(found: Difference, first: Divergence) -> str:
    step, stays = step_of(found, first), _stays(found, first)
    if not gap_before(first):
        return f"differ from {step} on" if stays else f"differ first at {step}"
    state = "the next recorded state" if found.one_recording else "the next state that both recorded"
    differ = f"differ from {state} on" if stays else f"differ first at {state}"
    return f"are equal at step {first.after_step} and {differ}, {step}"


def _place(found: Difference, first: Divergence) -> str:
    env = f", first {pair_of(found, first)}" if found.compared.n_env > 1 else ""
    if first.located and first.state is not None:
        return f"{env}: {place_of(first.state.number)}: {apart(first.state.number)}"
    if first.phase == "capture" and found.compared.state_steps is not None:
        return f"{env}; body and field are unknown, because no state of that step was recorded"
    return f"{env}; body and field are unknown, because only hashes were recorded"


def _whose(found: Difference, first: Divergence) -> str:
    """Of a task: whether what the program gave its environments differs first, or what they returned."""
    every_step = first.step_a == first.step_b and first.located and first.phase == "capture"  # of both, up to there
    state = first.state if every_step and not found.one_recording else None
    if state is None or not any(is_action(field.field) for field in found.compared.fields):
        return ""
    if any(map(is_action, state.fields)):
        return " The actions differ first: all that the environments returned before that step is the same."
    if first.step_a == 0:
        return " What the reset returned differs already: no action precedes it."
    return " The environments differ first: the actions up to that step are the same."


def _stays(found: Difference, first: Divergence) -> bool:
    """Whether no pair is known to become equal again, so that the sides differ at every known step from here on."""
    if _beside_capture(found, first):
        return False  # it is not known pair by pair
    agreeing = found.splits.agreeing
    then = [change.count for change in agreeing if change.step <= first.step_a][-1:]
    later = [change.count for change in agreeing if change.step > first.step_a]
    counts = [*then, *later]
    return bool(then) and then[0] < found.compared.n_env and counts == sorted(counts, reverse=True)


def _beside_capture(found: Difference, first: Divergence) -> bool:
    """Whether the first difference is in the timed phase of runs that were captured, too."""
    return first.phase == "timed" and found.compared.hash_phase != "timed"


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
