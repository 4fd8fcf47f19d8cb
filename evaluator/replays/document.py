"""What gsb-replay says: the verdict, how many episodes have which, and each episode; and the same as JSON."""

from __future__ import annotations

from collections.abc import Iterator

from gpusimbench.evaluator.diff.brief import apart, place_of
from gpusimbench.evaluator.json_values import document_of, dump, values_of
from gpusimbench.evaluator.render.document import NONE, Block, Cell, Document, Text, Tone, facts, items, table
from gpusimbench.evaluator.render.numbers import bounds
from gpusimbench.evaluator.replays.comparison import ReplayComparison, Share
from gpusimbench.evaluator.replays.verdict import EpisodeVerdict, Judged
from gpusimbench.schemas.text import plural

_SHOWN = 12
_SETTINGS = 8
_COLUMNS = (
    "env",
    "episode",
    "verdict",
    "steps",
    "return",
    "return, replay",
    "bits differ",
    "largest",
    "outcome leaves",
)
_TONES = {
    EpisodeVerdict.IDENTICAL: Tone.GOOD,
    EpisodeVerdict.SAME: Tone.PLAIN,
    EpisodeVerdict.UNKNOWN: Tone.WARNING,
    EpisodeVerdict.OTHER: Tone.BAD,
    EpisodeVerdict.ABSENT: Tone.WARNING,
}
_WORST = (
    EpisodeVerdict.ABSENT,
    EpisodeVerdict.OTHER,
    EpisodeVerdict.UNKNOWN,
    EpisodeVerdict.SAME,
    EpisodeVerdict.IDENTICAL,
)


def replay_document(found: ReplayComparison, *, every: bool = False) -> Document:
    """The verdict and what it rests on.

    every  whether all episodes are listed; else the worst
    """
    blocks: list[Block] = [Text(verdict(found), _tone(found))]
    blocks.append(
        facts(
            ("original", Cell(found.original, code=True)),
            ("replay", Cell(found.replay, code=True)),
            ("task", found.task),
            *([("first", first_words(found))] if first_words(found) else []),
        )
    )
    blocks.append(
        table(
            "verdicts",
            "",
            ("", "episodes", "share", "95 %"),
            [_share(one) for one in found.shares if one.episodes or one.verdict is not EpisodeVerdict.UNKNOWN],
        )
    )
    ordered = sorted(found.episodes, key=lambda one: _WORST.index(one.verdict))
    shown = found.episodes if every else ordered[:_SHOWN]
    blocks.append(table("episodes", "", _COLUMNS, [_row(one) for one in shown]).without_empty_columns())
    if left := len(found.episodes) - len(shown):
        blocks.append(Text(f"{plural(left, 'more episode')}: --all shows them", Tone.QUIET))
    if told := list(warnings(found)):
        blocks.append(items(*told, tone=Tone.WARNING))
    if found.settings and found.count(EpisodeVerdict.IDENTICAL) < len(found.episodes):
        told = [f"{one.name}: {one.a}, in the replay {one.b}" for one in found.settings[:_SETTINGS]]
        if more := len(found.settings) - _SETTINGS:
            told += [f"{more} more: gsb-diff shows them"] if more > 0 else []
        blocks += [Text("What is not the same:"), items(*told)]
    return Document("", tuple(blocks))


def dump_json(found: ReplayComparison) -> str:
    """The document that ``gsb-replay --json`` writes."""
    return dump(document_of({**values_of(found), "warnings": list(warnings(found))}))


def verdict(found: ReplayComparison) -> str:
    """The verdict in a sentence."""
    n, counts = len(found.episodes), {one.verdict: one.episodes for one in found.shares}
    if counts[EpisodeVerdict.IDENTICAL] == n:
        return f"{_all(found)} bit for bit."
    if counts[EpisodeVerdict.IDENTICAL] + counts[EpisodeVerdict.SAME] == n:
        return f"{_all(found)} with the same outcome; {counts[EpisodeVerdict.SAME]} with other bits."
    if not any(counts[one] for one in _WORDS):
        return (
            f"{counts[EpisodeVerdict.UNKNOWN]} of {plural(n, 'episode')} with other bits; the data set has neither "
            "rewards nor success, so outcomes are not compared."
        )
    other = [f"{counts[one]} {words}" for one, words in _WORDS.items() if counts[one]]
    return f"Of {plural(n, 'episode')}, {' and '.join(other)}."


_WORDS = {
    EpisodeVerdict.OTHER: "end with another outcome in the replay",
    EpisodeVerdict.ABSENT: "could not be replayed",
}


def _all(found: ReplayComparison) -> str:
    n, cut = len(found.episodes), sum(one.ends[0] == "cut" for one in found.episodes)
    some = f" {cut} of them" if cut < n else ""
    as_far = f",{some} as far as recorded," if cut else ""
    return f"All {n} episodes{as_far} replay" if n > 1 else f"The episode{as_far} replays"


def first_words(found: ReplayComparison) -> str:
    """Where bits differ first, of the episode in which that is earliest; empty where they do not."""
    apart_at = [one for one in found.episodes if one.first is not None]
    if not apart_at:
        return ""
    one = min(apart_at, key=lambda judged: judged.first.step if judged.first else 0)
    assert one.first is not None
    return (
        f"step {one.first.step} of episode {one.number} of env {one.env}: {place_of(one.first.number)}: "
        f"{apart(one.first.number)}"
    )


def warnings(found: ReplayComparison) -> Iterator[str]:
    """What a reader of the verdict must know, a sentence each."""
    if found.began_otherwise:
        yield (
            f"{plural(found.began_otherwise, 'episode')} began with another observation: the environment, its seed or "
            "its random numbers differ before any action, so that the actions cannot lead to the same states"
        )
    if found.of_data_set and found.count(EpisodeVerdict.IDENTICAL) < len(found.episodes):
        yield "the data set does not say which versions and which machine made it; a difference there may be the reason"
    if names := dict.fromkeys(name for one in found.episodes for name in one.rounded):
        yield f"compared in float32, since one of the files holds no more digits: {', '.join(names)}"
    if cut := sum(one.ends[0] == "cut" for one in found.episodes):
        has = "has" if cut == 1 else "have"
        yield (
            f"{plural(cut, 'episode')} of the original {has} no end, because a reset or the end of the recording came "
            "first or the data set does not tell it: the recorded steps alone are compared"
        )
    if any(one.returns[0] is None for one in found.episodes):
        yield "the original has no rewards: returns were not compared"
    for text in dict.fromkeys(text for one in found.episodes for text in one.not_compared):
        yield f"not compared: {text}"


def _tone(found: ReplayComparison) -> Tone:
    return _TONES[min((one.verdict for one in found.episodes), key=_WORST.index)]


def _share(of: Share) -> list[Cell | str]:
    def percent(share: float) -> str:
        return f"{100 * share:.1f} %"

    return [of.verdict.value, str(of.episodes), percent(of.share), bounds(of.ci95, percent)]


def _row(of: Judged) -> list[Cell | str]:
    steps = str(of.steps[0]) if of.steps[0] == of.steps[1] else f"{of.steps[0]}, replay {of.steps[1]}"
    first = NONE
    if of.first is not None:
        first = f"step {of.first.step}: {place_of(of.first.number)}, {apart(of.first.number)}"
    largest = NONE
    if of.largest is not None and of.largest.distance:
        largest = f"{of.largest.distance:.3g} at step {of.largest.step}"
    return [
        str(of.env),
        str(of.number),
        Cell(of.verdict.value, tone=_TONES[of.verdict]),
        steps,
        *(
            NONE if total is None else f"{total:.6g}"
            for total in of.returns[: 1 if of.verdict is EpisodeVerdict.ABSENT else 2]
        ),
        *([NONE] if of.verdict is EpisodeVerdict.ABSENT else []),
        first,
        largest,
        _left(of),
    ]


def _left(of: Judged) -> str:
    if of.left_at is None:
        return NONE
    told = [f"step {of.left_at}"]
    if of.ends[0] != of.ends[1]:
        told.append(f"{of.ends[0]}, replay {of.ends[1]}")
    if of.success is not None and of.success[0] != of.success[1]:
        told.append("succeeded, replay failed" if of.success[0] else "failed, replay succeeded")
    return "; ".join(told)
