"""What a comparison comes to, in a sentence: are the two the same, and if not, where is the first difference?"""

from __future__ import annotations

from gpusimbench.evaluator.diff import words
from gpusimbench.evaluator.diff.program_parts import is_action
from gpusimbench.evaluator.diff.result import Difference, DiffVerdict, Divergence, Number
from gpusimbench.evaluator.diff.words import WITHOUT_UNIT
from gpusimbench.evaluator.render.document import Text, Tone
from gpusimbench.schemas.fields import ENV
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
    return Text(f"{who} {since}{_where(found, found.first)}.{_whose(found, found.first)}", Tone.BAD)


def step_of(found: Difference, first: Divergence) -> str:
    """The first step that differs, with its time; of which phase, where the capture is known beside it."""
    step = f"{first.step_a}" if first.step_a == first.step_b else f"{first.step_a} of a, {first.step_b} of b"
    return f"step {step} ({first.time:g} s){' of the timed phase' if _beside_capture(found, first) else ''}"


def gap_before(first: Divergence) -> bool:
    """Whether steps before it are not known, at any of which the two may have parted."""
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
    return f"in env {first.env_a}"


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


def _where(found: Difference, first: Divergence) -> str:
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
    """Whether the difference is of the timed phase, and a capture beside it is the same."""
    return first.phase == "timed" and found.compared.hash_phase != "timed"
