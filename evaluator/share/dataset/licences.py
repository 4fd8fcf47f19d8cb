"""Licences that a set can be published under: names of SPDX, and what the Hugging Face Hub calls them."""

from __future__ import annotations

import re

from gpusimbench.schemas.errors import UsageError

_FAMILIES = {"ODC-By-1.0": "odc-by", "ODbL-1.0": "odbl", "PDDL-1.0": "pddl", "C-UDA-1.0": "c-uda"}
"""Whose name at the Hub is not that of SPDX in small letters."""

_ALIKE = (
    "AGPL-3.0", "Apache-2.0", "BSD-2-Clause", "BSD-3-Clause", "BSL-1.0", "CC-BY-2.0", "CC-BY-2.5", "CC-BY-3.0",
    "CC-BY-4.0", "CC-BY-NC-3.0", "CC-BY-NC-4.0", "CC-BY-NC-ND-4.0", "CC-BY-NC-SA-3.0", "CC-BY-NC-SA-4.0",
    "CC-BY-ND-4.0", "CC-BY-SA-3.0", "CC-BY-SA-4.0", "CC0-1.0", "CDLA-Permissive-1.0", "CDLA-Sharing-1.0", "EPL-2.0",
    "etalab-2.0", "GPL-2.0", "GPL-3.0", "ISC", "LGPL-2.1", "LGPL-3.0", "MIT", "MPL-2.0", "Unlicense", "Zlib",
)  # fmt: skip

HUB_NAMES = {**{name: name.lower() for name in _ALIKE}, **_FAMILIES}
"""By SPDX identifier. Each of them is also in the list of Citation File Format 1.2.0."""

OWN = re.compile(r"LicenseRef-[A-Za-z0-9.-]{1,60}")
"""SPDX's way to name terms that are in no list; their text is the file LICENSE of the set."""

_ASK = (
    "whoever publishes must say on what terms: give --licence an SPDX identifier, such as CC-BY-4.0 (use it and name "
    "us), CC0-1.0 (do as you like) or Apache-2.0"
)


def check_licence(name: str | None) -> str:
    """A licence's SPDX identifier as it is written; UsageError that says what to do where there is none."""
    if not name:
        raise UsageError(f"no licence was given, and none can be made up: {_ASK}")
    known = {spdx.lower(): spdx for spdx in HUB_NAMES}
    if name.lower() in known:
        return known[name.lower()]
    if OWN.fullmatch(name):
        return name
    raise UsageError(
        f"--licence {name!r} is not among those known here; {_ASK}. Known: {', '.join(sorted(HUB_NAMES))}; for terms "
        "of your own LicenseRef-NAME, with their text in the file LICENSE of the folder"
    )
