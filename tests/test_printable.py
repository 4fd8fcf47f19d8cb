"""Text of strangers, as it is shown."""

from __future__ import annotations

import pytest

from schemas.printable import printable


@pytest.mark.parametrize("sign", ["\u202e", "\u2066", "\x1b", "\x9b", "\udcff"])
def test_what_moves_other_text_is_shown(sign: str) -> None:
    """Show control characters, halves of pairs and changes of direction as escapes."""
    assert printable(f"a{sign}b") == f"a\\x{ord(sign):02x}b"


def test_letters_stay() -> None:
    """Leave letters of any script, signs and line breaks as they are."""
    assert printable("é 中 ع ± × 10⁻³\n") == "é 中 ع ± × 10⁻³\n"
