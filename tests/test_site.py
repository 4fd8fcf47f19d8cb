"""The site of the documents: whole, without a dead link, and without a request to anywhere."""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from tests.conftest import finished
from tests.scripts import DOCUMENTS, script

ROOT = Path(__file__).resolve().parent.parent

needs_mkdocs = pytest.mark.skipif(
    importlib.util.find_spec("material") is None, reason="mkdocs-material is not installed"
)
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source of every page, as the site is built of it."""
    folder = tmp_path_factory.mktemp("pages")
    script("build_site").gather(folder)
    return folder


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built by its command in a process of its own."""
    folder = tmp_path_factory.mktemp("site") / "site"
    done = finished([sys.executable, DOCUMENTS / "build_site.py", folder], cwd=ROOT)
    assert done.stdout.strip().endswith(": 0 warnings")
    return folder


class _Page(HTMLParser):
    """What a page links to, what it loads, and the names of its places."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.loads: set[str] = set()
        self.names: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value for name, value in attrs if value}
        self.names.update(given[name] for name in ("id", "name") if name in given)
        if tag == "a" and "href" in given or tag == "link" and given.get("rel") in ("canonical", "prev", "next"):
            self.links.add(given["href"])
        else:
            self.loads.update(given[name] for name in ("src", "href", "srcset", "poster", "data") if name in given)


def test_every_command_has_a_page(sources: Path) -> None:
    """Make a page for each installed command that names each of its options and exit codes."""
    reference = script("make_reference")
    for name, parser in reference.parsers().items():
        text = (sources / "reference" / f"{name}.md").read_text(encoding="utf-8")
        assert f"reference/{name}.md" in (DOCUMENTS / "mkdocs.yml").read_text(encoding="utf-8"), "add it to the nav"
        for each in (parser, *reference.verbs(parser).values()):
            for option in each._option_string_actions:
                assert f"`{option}" in text, f"{name} {option}"
        for code in reference.codes(parser.epilog):
            assert f"| {code} | " in text


def test_the_reference_is_of_the_code(sources: Path) -> None:
    """Show every rule, metric, message, simulator, option and scene that there is."""
    from gpusimbench.evaluator.check.rules.rule import SHIPPED, load_rules
    from gpusimbench.recorder.scenes.registry import SCENES
    from gpusimbench.recorder.simulators.registry import BUILT_IN

    text = {page.stem: page.read_text(encoding="utf-8") for page in (sources / "reference").glob("*.md")}
    assert all(f"`{rule.id}`" in text["rules"] for name in SHIPPED for rule in load_rules(name).rules)
    assert all(f"## {entry.name}\n" in text["options"] for entry in BUILT_IN)
    assert "cannot be shown" not in text["options"]
    assert all(f"## {scene}\n" in text["scenes"] for scene in SCENES)
    assert len(re.findall(r"^message ", text["messages"], re.MULTILINE)) >= 11
    assert "| `fps` | env-steps/s | higher |" in text["metrics"]
    assert "FPS = N_env * N_step / T_step" in text["formulas"]
    assert "mean over run pairs r < r'" in text["formulas"]


def test_links_are_followed_to_their_place_on_the_site() -> None:
    """Replace the target of each link, and leave code as it is."""
    text = "[`a`](x.md) and `[b](y.md)` and [c](z.md#there)\n```text\n[d](w.md)\n```\n"
    found = script("build_site").with_links(text, lambda link: f"new/{link}")
    assert found == "[`a`](new/x.md) and `[b](y.md)` and [c](new/z.md#there)\n```text\n[d](w.md)\n```\n"


def test_a_link_that_leads_nowhere_is_an_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Refuse a document whose link has no target in the repository, and say which."""
    builder = script("build_site")
    monkeypatch.setattr(builder.make_reference, "pages", lambda: {"index": "[gone](../no-such-page.md)"})
    with pytest.raises(ValueError, match="docs/reference/index.md links to ../no-such-page.md"):
        builder.gather(tmp_path)


@needs_mkdocs
@pytest.mark.slow
def test_pages_lead_to_pages(site: Path) -> None:
    """Find the target of every link of every page, file and place, within the site."""
    pages = {path: _Page(path) for path in site.rglob("*.html") if path.name != "404.html"}
    assert len(pages) > 60
    assert (site / "index.html") in pages
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme in ("http", "https"):
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            assert target.exists(), f"{path.relative_to(site)}: {link}"
            if parts.fragment and target in pages:
                assert unquote(parts.fragment) in pages[target].names | {"__top"}, f"{path.relative_to(site)}: {link}"


@needs_mkdocs
@pytest.mark.slow
def test_pages_load_nothing_from_elsewhere(site: Path) -> None:
    """Name no address in what a page loads: neither a font, nor a script, nor a picture."""
    for path in site.rglob("*.html"):
        for target in _Page(path).loads:
            assert urlsplit(target).scheme in ("", "data"), f"{path.relative_to(site)}: {target}"
            assert not target.startswith("//"), f"{path.relative_to(site)}: {target}"
    for path in site.rglob("*.css"):
        assert not re.search(r"(url\(|@import )[\"']?(https?:)?//", path.read_text(encoding="utf-8")), path.name


@needs_mkdocs
@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")
def test_search_works_in_a_page_opened_as_a_file(site: Path, tmp_path: Path) -> None:
    """Open the first page from the disk in a browser without a network, and find a word."""
    log = tmp_path / "net.json"
    done = subprocess.run(
        [str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=10000",
         "--disable-background-networking", "--disable-component-update", "--no-first-run",
         f"--user-data-dir={tmp_path / 'profile'}", f"--log-net-log={log}", "--host-resolver-rules=MAP * ~NOTFOUND",
         "--dump-dom", f"{(site / 'index.html').as_uri()}?q=jackknife"],
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    found = re.search(r"(\d+) matching documents", done.stdout)
    assert int(found[1]) >= 2
    asked = re.findall(r'"url":"(https?://[^"]+)"', log.read_text(encoding="utf-8"))
    assert not [url for url in asked if "unpkg" in url or "googleapis.com/css" in url or "github" in url]
