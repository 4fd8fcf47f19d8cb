"""Licences that a set can be published under; and CITATION.cff: how a set wants to be cited, in version 1.2.0 of it."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass

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

CITATION = "CITATION.cff"

_ORCID = re.compile(r"(?:https://orcid\.org/)?(\d{4}-\d{4}-\d{4}-\d{3}[\dX])")
_DOI = re.compile(r"10\.\d{4,9}(\.\d+)?/[A-Za-z0-9:/_;\-.()\[\]\\]+")
_URL = re.compile(r"https?://[^\s\"<>]+")
_LONGEST = 200


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


@dataclass(frozen=True)
class Author:
    """A person, or with an empty `given` name an organisation; ORCID as 0000-0000-0000-0000."""

    family: str
    given: str = ""
    affiliation: str = ""
    orcid: str = ""

    @property
    def shown(self) -> str:
        """The name as a sentence has it."""
        return f"{self.given} {self.family}".strip()


def parse_author(text: str) -> Author:
    """From "Family, Given; affiliation; ORCID", the last two optional; UsageError where it is something else."""
    name, *more = (part.strip() for part in text.split(";"))
    family, _, given = (part.strip() for part in name.partition(","))
    if not family or len(more) > 2 or len(text) > _LONGEST or not text.isprintable():
        raise UsageError(
            f"--author takes 'Family, Given', 'Family, Given; affiliation' or 'Family, Given; affiliation; ORCID', not "
            f"{text[:_LONGEST]!r}"
        )
    affiliation, orcid = (*more, "", "")[:2]
    if orcid and (not (found := _ORCID.fullmatch(orcid)) or not _checks(found[1])):
        raise UsageError(f"{orcid!r} is no ORCID: four groups of four digits, the last one a check digit")
    return Author(family, given, affiliation, orcid and orcid[-19:])


def _checks(orcid: str) -> bool:
    # ISO 7064, MOD 11-2
    total = 0
    for digit in orcid.replace("-", "")[:-1]:
        total = (total + int(digit)) * 2
    return "0123456789X"[(12 - total % 11) % 11] == orcid[-1]


def check_doi(doi: str | None) -> str:
    """A DOI without the address of a resolver; UsageError where it is none."""
    if not doi:
        return ""
    bare = re.sub(r"^(https?://(dx\.)?doi\.org/|doi:)", "", doi)
    if not _DOI.fullmatch(bare):
        raise UsageError(f"--doi takes a DOI such as 10.5281/zenodo.1003150, not {doi!r}")
    return bare


def check_url(url: str | None) -> str:
    """The address of a page of the set; UsageError where it is none."""
    if not url:
        return ""
    if not _URL.fullmatch(url) or "@" in url.partition("://")[2].partition("/")[0]:
        raise UsageError(f"--url takes the address of a page, https://..., not {url!r}")
    return url


@dataclass(frozen=True)
class Publication:
    """What nobody but the publisher knows of a set.

    title    of the set
    licence  SPDX identifier
    authors  in their order
    doi      without the address of a resolver; empty for none
    url      of its page; empty for none
    about    the publisher's own words, in Markdown; empty for none
    """

    title: str
    licence: str
    authors: tuple[Author, ...]
    doi: str = ""
    url: str = ""
    about: str = ""


def quoted(text: str) -> str:
    """A text as YAML has it, whatever is in it: a string of JSON is one of YAML 1.2."""
    return json.dumps(text, ensure_ascii=True)


def citation(publication: Publication, abstract: str, identity: str, keywords: Sequence[str]) -> str:
    """The file's text.

    identity  of the set's content, in hexadecimal
    """
    lines = [
        "cff-version: 1.2.0",
        "type: dataset",
        f"title: {quoted(publication.title)}",
        'message: "If you use these recordings, please cite them as below."',
        "authors:",
    ]
    for author in publication.authors:
        fields = (
            {"family-names": author.family, "given-names": author.given, "affiliation": author.affiliation}
            if author.given
            else {"name": author.family}
        )
        if author.orcid:
            fields["orcid"] = f"https://orcid.org/{author.orcid}"
        told = [f"{key}: {quoted(value)}" for key, value in fields.items() if value]
        lines += [f"  - {told[0]}", *(f"    {line}" for line in told[1:])]
    lines.append(f"abstract: {quoted(abstract)}")
    if publication.licence in HUB_NAMES:
        lines.append(f"license: {publication.licence}")
    if publication.doi:
        lines.append(f"doi: {quoted(publication.doi)}")
    if publication.url:
        lines.append(f"url: {quoted(publication.url)}")
    lines += [
        "identifiers:",
        "  - type: other",
        f"    value: {quoted(f'sha256:{identity}')}",
        '    description: "SHA-256 of the content hashes of all recordings, sorted, a line each"',
        "keywords:",
        *(f"  - {quoted(word)}" for word in keywords),
    ]
    return "\n".join(lines) + "\n"
