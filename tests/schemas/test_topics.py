"""Topic names are read as they are written, and no kind of topic is taken for another."""

from __future__ import annotations

import string

from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.schemas import topics

NAME = st.text(string.ascii_lowercase + string.digits + "_", min_size=1, max_size=12)
ENV = st.integers(0, 999_999_999)
PARSERS = (topics.parse_state, topics.parse_view, topics.parse_action, topics.parse_count)


def parsed(topic: str) -> list[tuple[object, ...] | None]:
    """What each parser makes of a topic."""
    return [parse(topic) for parse in PARSERS]


@given(NAME.filter(lambda name: name != "view"), NAME, ENV)
def test_topics_are_read_as_they_are_written(one: str, other: str, env: int) -> None:
    """Give back the parts of each topic, by the parser of its kind alone."""
    assert parsed(topics.state(one, other, env)) == [(one, other, env), None, None, None]
    assert parsed(topics.view(other, env)) == [None, (other, env), None, None]
    assert parsed(topics.action(one, env)) == [None, None, (one, env), None]
    assert parsed(topics.count(one, other)) == [None, None, None, (one, other)]
    for topic in (topics.timing(one), topics.overflow(one), topics.fingerprint(one), topics.flight(env, one, other)):
        assert parsed(topic) == [None] * 4
    assert topics.states_of([topics.state(one, other, env), topics.state(one, f"{other}_", 0)], one, other) == {
        topics.state(one, other, env): env
    }


def test_topics_sort_by_environment() -> None:
    """Pad the number of an environment to six digits."""
    assert topics.state("arm", "qpos", 7) == "/state/arm/qpos/000007"
    assert topics.view("scene", 1234567) == "/state/view/scene/1234567"
    assert topics.flight(7, "arm", "qpos") == "/flight/000007/arm/qpos"
    assert topics.action("arm", 7) == "/action/arm/000007"


def test_which_topics_have_a_digest() -> None:
    """Leave out states and views, which have digests by field or follow from states, and the end, where digests are."""
    have = (topics.timing("timed"), topics.RUN_EVENT, topics.flight(0, "arm", "qpos"), topics.action("arm", 0))
    have_not = (topics.state("arm", "qpos", 0), topics.view("scene", 0), topics.RUN_END)
    assert all(map(topics.has_digest, have))
    assert not any(map(topics.has_digest, have_not))
