"""The identity of a recording cannot be imitated by text that holds line breaks."""

from __future__ import annotations

from gpusimbench.schemas.digest import content_hash


def test_a_reason_cannot_pass_for_streams() -> None:
    """Tell a stream from a reason that spells its line, and both from any other."""
    honest = content_hash({"a": "1", "b": "2"}, "complete", "")
    assert content_hash({"a": "1"}, "complete", "\nb 2") != honest
    assert content_hash({"a 1\nb": "2"}, "complete", "") != honest
    assert content_hash({"a": "1"}, "complete", "x\ny") != content_hash({"a": "1"}, "complete", "x\\ny")


def test_one_line_is_as_it_was() -> None:
    """Keep the identity of recordings whose texts have one line, backslashes too."""
    import hashlib

    lines = sorted(["status failed\n", "reason C:\\new\n", "a 1\n"])
    assert content_hash({"a": "1"}, "failed", "C:\\new") == hashlib.sha256("".join(lines).encode()).hexdigest()
