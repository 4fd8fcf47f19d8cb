"""What is said of arrays that differ: the verdict, both numbers, and what else differs at that step."""

from __future__ import annotations

from gpusimbench.evaluator.diff import words
from gpusimbench.evaluator.diff.arrays import ArrayDivergence, ArraysDifference
from gpusimbench.evaluator.diff.verdict import apart, both_of, place_of
from gpusimbench.evaluator.render.document import Block, Document, Text, Tone, facts, items
from gpusimbench.schemas.text import plural

_FIELDS = 8


def arrays_document(found: ArraysDifference, names: tuple[str, str]) -> Document:
    """The verdict and what it rests on.

    names  of the two sides
    """
    who = f"{names[0]} and {names[1]}"
    if found.identical:
        return Document("", (Text(f"{who} are bit-identical.", Tone.GOOD),))
    blocks: list[Block] = []
    if found.first:
        blocks += [Text(f"{who} differ first at {_where(found.first)}.", Tone.BAD), _facts(found.first)]
    elif found.compared:
        blocks.append(Text(f"{who} are not alike, although what could be compared is bit-identical.", Tone.BAD))
    else:
        blocks.append(Text(f"{who} are not alike, and nothing of them can be compared.", Tone.BAD))
    if found.unlike:
        blocks.append(items(*(f"  not compared: {text}" for text in found.unlike), tone=Tone.WARNING))
    return Document("", tuple(blocks))


def _where(first: ArrayDivergence) -> str:
    env = f", in env {first.env}" if first.n_env > 1 else ""
    return f"step {first.step}{env}: {place_of(first.number)}: {apart(first.number)}"


def _facts(first: ArrayDivergence) -> Block:
    step = f"step {first.step}"
    if first.after_step is not None:
        step += f"; equal up to step {first.after_step}"
    if first.n_env > 1:
        step += f"; {first.envs:,} of {plural(first.n_env, 'env', spec=',')} differ at that step, first env {first.env}"
    return facts(
        ("first at", step),
        ("fields", words.names(first.fields, _FIELDS)),
        ("first number", both_of(first.number)),
    )
