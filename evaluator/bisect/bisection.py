"""A bisection by halves: which releases are recorded, what each showed, where the change lies; in words and as JSON."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from gpusimbench.evaluator.bisect.environment import NotInstalled, Plan, environment_of
from gpusimbench.evaluator.bisect.predicates import STATES, Predicate, ReleaseVerdict, by_states, first_number
from gpusimbench.evaluator.compute.recorder import record
from gpusimbench.evaluator.diff.result import Setting
from gpusimbench.evaluator.diff.settings import differing_settings
from gpusimbench.evaluator.diff.words import names
from gpusimbench.evaluator.json_values import document_of, dump, values_of
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.document import Block, Cell, Document, Text, Tone, facts, table
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.schemas.commands.progress import stage
from gpusimbench.schemas.errors import GsbError, UsageError
from gpusimbench.schemas.location import place

_ENVIRONMENTS = "environments"
_PACKAGES = "software.packages."
_OURS = ("software.recorder.",)  # which code recorded: a bisection that goes on later may have another

_WORDS = {True: ("differs", Tone.BAD), False: ("the same", Tone.GOOD), None: ("not judged", Tone.WARNING)}


@dataclass(frozen=True)
class Bounds:
    """Between which releases the change lies, as indices.

    same       the last that is known to be like the first of all
    different  the first that is known to differ; None: the last of all does not
    skipped    releases between them that could not be judged
    """

    same: int
    different: int | None
    skipped: tuple[int, ...] = ()


def most(count: int) -> int:
    """How many of so many releases are recorded at most, where all can be judged: ceil(log2(count)) + 2."""
    return (count - 1).bit_length() + 2


def search(count: int, judge: Callable[[int], bool | None]) -> Bounds:
    """Find two neighbours of which the one is like release 0 and the other is not.

    count  of releases, at least 2
    judge  whether a release differs from release 0; None where that cannot be told. It is asked of the last release
           first, never of release 0, and never twice

    Where releases change back and forth, this is one of the changes. Where the last release cannot be judged, it is
    among the skipped, and nothing is known to differ.
    """
    last = count - 1
    verdict = judge(last)
    if not verdict:
        return Bounds(last, None) if verdict is False else Bounds(0, None, (last,))
    low, high = 0, last
    skipped: set[int] = set()
    while left := [i for i in range(low + 1, high) if i not in skipped]:
        middle = min(left, key=lambda i: abs(2 * i - low - high))
        verdict = judge(middle)
        if verdict is None:
            skipped.add(middle)
        elif verdict:
            high = middle
        else:
            low = middle
    return Bounds(low, high, tuple(i for i in sorted(skipped) if low < i < high))


class NotRecorded(GsbError):
    """A release whose runs fail."""


class Refused(NotRecorded):
    """A release of which gsb-record begins no run: it lacks something, or no release can do what is asked."""


@dataclass(frozen=True)
class Bisection:
    """What was found.

    package, simulator, scene, predicate  what was asked of which
    options       with which every release was recorded
    versions      from the good release to the bad one
    tested        what each recorded release showed, by version, in the order of versions; the good one aside
    files         recordings of each
    same          last release that is known to be like the good one
    different     first release that is known to differ; None where the bad one does not
    skipped       releases between the two that could not be judged
    step          how far the states of these two differ; empty where no release differs
    first         the first number in which they do; empty where none is recorded
    packages      packages whose version is another in the environments of these two
    settings      what else their recordings say of themselves and differ in
    """

    package: str
    simulator: str
    scene: str
    predicate: str
    options: tuple[str, ...]
    versions: tuple[str, ...]
    tested: Mapping[str, ReleaseVerdict]
    files: Mapping[str, tuple[str, ...]]
    same: str
    different: str | None
    skipped: tuple[str, ...]
    step: str
    first: str
    packages: tuple[Setting, ...]
    settings: tuple[Setting, ...]

    @property
    def exact(self) -> bool:
        """Whether the first release that differs is known."""
        return self.different is not None and not self.skipped

    @property
    def once(self) -> bool:
        """Whether states are said to differ, and nothing shows that the engine repeats itself: no release has two
        runs, and none that was recorded has the states of the good one."""
        repeated = any(len(files) > 1 for files in self.files.values())
        alike = any(verdict.different is False for verdict in self.tested.values())
        return self.predicate == STATES and self.different is not None and not (repeated or alike)


@dataclass
class Releases:
    """Releases and their recordings, made where they are not there yet.

    package  that pip installs
    given    Pythons of releases that are there already, by version; empty: environments are made
    out      folder of all that is made: a folder of recordings for each version, and environments/
    say      gets a line for each thing that is done
    """

    package: str
    plan: Plan
    out: Path
    given: Mapping[str, Path] = field(default_factory=dict)
    say: Callable[[str], None] = lambda text: None

    def recorded(self, version: str) -> list[Recording]:
        """All runs of a release; NotInstalled or NotRecorded where it cannot have them."""
        folder = self.out / version
        there = self._recordings_in(folder, version)
        if (missing := self.plan.runs - len(there)) > 0:
            python = self._python(version)
            with stage(f"recording {self.package} {version}"):
                made, refused = record(self.plan.arguments(python, missing, folder), lambda text: None)
            failed = [run for run in made if run.file is None or run.status not in ("complete", "invalid")]
            cannot = f"{self.package} {version} cannot be recorded"
            if refused:
                raise Refused(f"{cannot}: {refused}")
            if failed:
                raise NotRecorded(f"{cannot}: {failed[0].status}: {failed[0].reason}")
            there = self._recordings_in(folder, version)
            if len(there) < self.plan.runs:
                raise NotRecorded(f"{self.package} {version} has {len(there)} of {self.plan.runs} recordings")
        for recording in there:
            verify(recording)
        return there[: self.plan.runs]

    def _python(self, version: str) -> Path:
        if version in self.given:
            return self.given[version]
        with stage(f"installing {self.package} {version}"):
            return environment_of(self.out / _ENVIRONMENTS / version, self.package, version)

    def _recordings_in(self, folder: Path, version: str) -> list[Recording]:
        found = [Recording(place(str(path))) for path in (sorted(folder.glob("*.mcap")) if folder.is_dir() else [])]
        found = [recording for recording in found if recording.status in ("complete", "invalid")]
        for recording in found:
            packages = recording.provenance.software.get("packages", {})
            other = packages.get(self.package, version) != version and not self.given
            if other or not self.plan.has(recording.configuration):
                raise UsageError(
                    f"{recording.path} is of another bisection: name another folder with --out, or remove {folder}"
                )
        return found


def bisect(releases: Releases, versions: tuple[str, ...], predicate: Predicate, asked: str) -> Bisection:
    """Record and judge releases until two neighbours are found of which one is like the first of all.

    asked  the predicate as the user named it

    NotInstalled or NotRecorded where the first or the last release has no recordings, UsageError where the first is
    refused.
    """
    try:
        files = {versions[0]: releases.recorded(versions[0])}
    except Refused as error:
        raise UsageError(str(error)) from None
    releases.say(f"{versions[0]}: recorded, the good one")
    tested: dict[str, ReleaseVerdict] = {}

    def judge(index: int) -> bool | None:
        version = versions[index]
        try:
            files[version] = releases.recorded(version)
        except (NotInstalled, NotRecorded) as error:
            if index == len(versions) - 1:
                raise
            tested[version] = ReleaseVerdict(None, str(error))
        else:
            tested[version] = predicate(files[versions[0]], files[version])
        said = {True: "differs", False: "the same", None: "not judged"}[tested[version].different]
        releases.say(f"{version}: {said}: {tested[version].evidence}")
        return tested[version].different

    bounds = search(len(versions), judge)
    return _bisection(releases, versions, bounds, tested, files, asked)


def _bisection(
    releases: Releases, versions: tuple[str, ...], bounds: Bounds, tested: dict[str, ReleaseVerdict],
    files: dict[str, list[Recording]], asked: str,
) -> Bisection:  # fmt: skip
    same = versions[bounds.same]
    different = None if bounds.different is None else versions[bounds.different]
    step, first = "", ""
    packages: tuple[Setting, ...] = ()
    others: tuple[Setting, ...] = ()
    if different is not None:
        one, other = files[same], files[different]
        step, first = by_states(one, other).evidence, first_number(one[0], other[0])
        found = {setting.name: setting for setting in differing_settings(one[0], other[0])}
        settings = [setting for name, setting in found.items() if not name.startswith(_OURS)]
        packages = tuple(
            Setting(setting.name.removeprefix(_PACKAGES), setting.a, setting.b)
            for setting in settings
            if setting.name.startswith(_PACKAGES)
        )
        others = tuple(s for s in settings if not s.name.startswith(_PACKAGES) and s.name != "version")
    plan = releases.plan
    return Bisection(
        releases.package, plan.simulator, plan.scene, asked, plan.options, versions,
        {version: tested[version] for version in versions if version in tested},
        {version: tuple(str(r.path) for r in files[version]) for version in versions if version in files},
        same, different, tuple(versions[index] for index in bounds.skipped), step, first, packages, others,
    )  # fmt: skip


_SHOWN_PACKAGES, _SETTINGS = 4, 4


def bisect_document(found: Bisection) -> Document:
    """The verdict, a row for each release that was recorded, and what changed with the first that differs."""
    good = ReleaseVerdict(False, "the good release")
    rows = [_row(version, verdict) for version, verdict in {found.versions[0]: good, **found.tested}.items()]
    blocks: list[Block] = [
        Text(verdict_of(found), Tone.PLAIN if found.exact and not found.once else Tone.WARNING),
        table("releases", "", ("release", f"against {found.versions[0]}", "evidence"), rows),
    ]
    if pairs := _pairs(found):
        blocks.append(facts(*pairs))
    return Document("", tuple(blocks))


def verdict_of(found: Bisection) -> str:
    """One sentence: which release is the first that differs."""
    what = "states" if found.predicate == STATES else "recordings"
    good, bad = found.versions[0], found.versions[-1]
    where = f"in {found.scene}"
    if found.different is None:
        return f"{found.package} {bad} does not differ from {good} {where}, judged by {found.predicate}."
    noise = " Whether runs of one release differ as well is not known: --runs 2 tells." if found.once else ""
    if found.skipped:
        left = f"{', '.join(found.skipped)} could not be judged"
        return (
            f"The {what} {where} changed after {found.package} {found.same} and up to {found.different}; {left}.{noise}"
        )
    first = f"{found.package} {found.different} is the first release"
    return f"{first} whose {what} {where} differ from those of {good}.{noise}"


def dump_json(found: Bisection) -> str:
    """The document that ``gsb-bisect --json`` writes."""
    return dump(document_of({"verdict": verdict_of(found), "exact": found.exact, **values_of(found)}))


def _row(version: str, verdict: ReleaseVerdict) -> list[Cell | str]:
    word, tone = _WORDS[verdict.different]
    return [version, Cell(word, tone=tone), verdict.evidence]


def _pairs(found: Bisection) -> list[tuple[str, str]]:
    if found.different is None:
        return []
    pairs = [(f"{found.same} to {found.different}", found.step)]
    if found.first:
        pairs.append(("first number", found.first))
    # the engine's own packages first: a release may come in several
    ordered = sorted(found.packages, key=lambda one: (not one.name.startswith(found.package), one.name))
    changed = names([f"{one.name} {one.a} to {one.b}" for one in ordered], _SHOWN_PACKAGES) or "the same versions"
    several = "several packages changed at once: " if len(found.packages) > 1 else ""
    pairs.append(("packages", f"{several}{changed}"))
    if found.settings:
        pairs.append(("also differs", names([one.name for one in found.settings], _SETTINGS)))
    return pairs
