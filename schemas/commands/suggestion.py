"""The known name that a mistyped name may have been meant to be."""

from __future__ import annotations

from collections.abc import Iterable

_MOST = 3  # names


def did_you_mean(given: str, known: Iterable[str]) -> str:
    """The end of a message on an unknown name, such as "; did you mean 'mujoco'?"; empty where no name is similar.

    Names are compared without regard to case, hyphens and underscores. A name that begins as the given one is similar.
    """
    from difflib import get_close_matches

    names: dict[str, str] = {}
    for name in known:
        names.setdefault(_plain(name), name)
    wanted = _plain(given)
    begun = [name for name in names if len(wanted) > 1 and name.startswith(wanted)]
    near = list(dict.fromkeys([*get_close_matches(wanted, names, n=_MOST), *begun]))[:_MOST]
    return f"; did you mean {' or '.join(repr(names[name]) for name in near)}?" if near else ""


def _plain(name: str) -> str:
    return name.lower().replace("_", "-")
