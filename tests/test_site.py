"""The site: every page, link and picture, in the text of the pages and in a browser."""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from tools import need, need_module

import albedo
from albedo import site as pages
from albedo.describe import reference, sources
from albedo.files import save_text
from albedo.ledger import Row
from albedo.papers import Paper, PaperClaim, PaperFigure
from albedo.site import render_study, write_site
from albedo.studies import StudyFile, run_study

STUDIES = Path(__file__).parent.parent / "studies"

LOBES = '''
"""Do two lobes differ?

They are Phong's & Ward's, <as printed>.
"""

import pandas as pd

from albedo import plotting
from albedo.studies import Study

STUDY = Study(
    name="lobes", title="Two lobes", paper="P", figure="Figure 2", claims=("P1", "P2", "P3")
)


def run(context):
    frame = pd.DataFrame({"model": ["phong", "ward"], "a": [0.25, 2.0], "a_error": [1e-9, 1e-3]})
    context.table("values", frame, "Values & more")
    context.table("others", frame, "Others")
    with plotting.style():
        figure, (axes,) = plotting.new_figure()
        axes.plot([0, 1], [0, 1])
    context.figure("picture", figure, "A line & its <end>")
    with plotting.style():
        figure, (axes,) = plotting.new_figure()
        axes.plot([0, 1], [1, 0])
    context.figure("second", figure, "Another line")
    context.note("They differ.")
    context.claim("P1", "Ward's albedo is below one.", 0.5, 1e-3, "< 1")
    context.claim("P2", "It is one.", 0.5, 1e-3, "< 1", reading="first", figure="second",
                  table="others", quantity="a number")
    context.claim("P2", "It is one.", 1.5, 1e-3, "< 1", reading="second")
    context.claim("P3", "It is small.", 2.0, 1e-3, "< 1")
    context.explain("P1", "Never shown among the claims.")
    context.explain("P2", "The words can be read in two ways.")
    context.explain("P3", "It is not small, as 2 > 1.")
    context.setting(rtol=1e-6)
'''

BROKEN = '''
"""Does this work?"""

from albedo.studies import Study

STUDY = Study(name="broken", title="A broken study")


def run(context):
    raise RuntimeError("no <luck>")
'''

# What the study of all models leaves, with numbers that are not its own.
MODELS = '''
"""What is the albedo of every model?"""

import numpy as np
import pandas as pd

import albedo
from albedo import plotting
from albedo.studies import Study

STUDY = Study(name="model_pages", title="Every model's albedo")


def run(context):
    names = list(albedo.models())
    for name in names:
        frame = pd.DataFrame({"cos_theta": [1.0], "albedo": [0.5], "albedo_error": [1e-9]})
        context.table(f"{name}_curves", frame, "Curves")
        context.table(f"{name}_map", frame, "Map")
        if name in ("lambert", "ward"):
            with plotting.style():
                figure, (axes,) = plotting.new_figure()
                axes.plot([0, 1], [0, 1])
            context.figure(f"{name}_figure", figure, f"Albedo of {name}")
    both = {"model": names, "promised": ["3 of 5 sets", *["yes"] * (len(names) - 1)]}
    kept = {"kept": ["yes", "no", *["yes"] * (len(names) - 2)]}
    context.table("reciprocity", pd.DataFrame(both | {"asymmetry": 1e-13} | kept))
    values = {"largest": 0.75, "largest_error": 1e-6, "at": "m = 1", "cos_theta": 0.5}
    values |= {"of_promises": 0.25, "of_promises_error": 1e-6}
    context.table("energy", pd.DataFrame(both | values | kept))
    values = {"growth": 1.0, "growth_error": 1e-6}
    context.table("horizon", pd.DataFrame(both | values | kept))
'''

DIGITS = '''
"""How many digits are right?"""

import pandas as pd

from albedo.studies import Study

STUDY = Study(name="stability", title="Digits")


def run(context):
    rows = {"model": "ward", "way": ["float64", "float32", "unheard"], "median": 15.0,
            "worst": 12.25, "lost": 3.0, "place": "normal", "cos_theta": 0.5}
    context.table("models", pd.DataFrame(rows))
'''


def made(folder: Path, sources: dict[str, str]) -> list[dict[str, Any]]:
    """Run studies as a report does; returns their manifests."""
    (folder / "files").mkdir()

    found = []
    for name, source in sources.items():
        path = folder / "files" / f"{name}.py"
        path.write_text(source)
        out = folder / "site" / "studies"
        result = run_study(StudyFile(path), out, keep_failure=True)
        assert result.folder is not None
        save_text(render_study(result.folder, result.manifest), result.folder / "index.html")
        found.append(result.manifest)
    return found


def rows_of(manifest: dict[str, Any]) -> list[Row]:
    def parts(id: str) -> tuple[dict[str, Any], ...]:
        return tuple({**c, "study": "lobes"} for c in manifest["claims"] if c["id"] == id)

    def why(id: str) -> tuple[str, ...]:
        return tuple(manifest["explanations"].get(id, ()))

    said = ("P", "Something about Ward & <others>", "sect. 1")
    return [
        Row("P1", *said, "holds", parts=parts("P1"), explanations=why("P1"), seconds=1.0),
        Row("P2", *said, "depends on the reading", why="Two readings.", parts=parts("P2"),
            explanations=why("P2"), seconds=1.0),
        Row("P3", *said, "fails: for one of 1", parts=parts("P3"), explanations=why("P3")),
        Row("P4", *said, "pending", pending="nobody has looked"),
        Row("P5", *said, "holds within the bound, 1e-9"),
    ]  # fmt: skip


PAPER = Paper(
    key="P",
    title="On <lobes>",
    authors="A. Author & B. Author",
    year=1999,
    about="It compares lobes.",
    figures=(
        PaperFigure("1", "A photograph", "there is nothing to measure"),
        PaperFigure("Figure 2", "Two lobes, side by side"),
        PaperFigure("3", "Nobody did this"),
    ),
    claims=tuple(PaperClaim(f"P{k}", "Something", "sect. 1") for k in range(1, 6)),
)


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A site with a paper, with what pages of models draw from, and with a broken study."""
    folder = tmp_path_factory.mktemp("full")
    files = {"lobes": LOBES, "broken": BROKEN, "model_pages": MODELS, "stability": DIGITS}
    manifests = made(folder, files)
    write_site(folder / "site", manifests, [PAPER], rows_of(manifests[0]))
    return folder / "site"


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A site of somebody's own studies: no papers, and rows about nothing."""
    folder = tmp_path_factory.mktemp("bare")
    write_site(folder / "site", made(folder, {"lobes": LOBES, "broken": BROKEN}), [], [])
    return folder / "site"


@pytest.fixture(params=["full", "bare"])
def site(request: pytest.FixtureRequest) -> Path:
    return request.getfixturevalue(request.param)


class Page(HTMLParser):
    """What is in a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert len(dict(attrs)) == len(attrs)
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "link", "img", "input", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        # The parser forgives what a browser would have to guess.
        assert self.open.pop() == tag

    def values(self, name: str) -> list[str]:
        return [attrs[name] or "" for _, attrs in self.tags if name in attrs]


def pages_of(site: Path) -> dict[Path, Page]:
    return {path: Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}


def test_every_link_and_anchor_leads_somewhere(site: Path) -> None:
    found = pages_of(site)
    assert len(found) >= len(albedo.models()) + 4
    ids = {path: page.values("id") for path, page in found.items()}
    for path, page in found.items():
        assert len(set(ids[path])) == len(ids[path]), path
        for name in ("aria-labelledby", "aria-describedby", "for"):
            assert set(page.values(name)) <= set(ids[path]), path
        for link in (*page.values("href"), *page.values("src")):
            where, _, anchor = link.partition("#")
            target = (path.parent / where).resolve() if where else path
            assert target.is_file(), f"{path}: {link}"
            assert site in target.parents
            if anchor:
                assert anchor in ids[target], f"{path}: {link}"


def test_pages_are_plain_and_in_order(site: Path) -> None:
    for path, page in pages_of(site).items():
        text = path.read_text(encoding="utf-8")
        assert "http" not in text, path
        assert str(site) not in text
        assert "nan" not in re.sub(r"<[^>]*>", " ", text).split(), path
        tags = [tag for tag, _ in page.tags]
        for tag in ("main", "h1", "header", "nav", "footer", "title"):
            assert tags.count(tag) == 1, (path, tag)
        levels = [int(tag[1]) for tag in tags if re.fullmatch("h[1-6]", tag)]
        assert all(lower - upper <= 1 for upper, lower in pairwise(levels)), (path, levels)
        for tag, attrs in page.tags:
            assert not [name for name in attrs if name.startswith("on") or name == "style"]
            if tag == "img":
                assert attrs["alt"], path
            if tag == "script":
                assert attrs["src"], path
            if tag == "th":
                assert attrs["scope"], path
    script = (site / "site.js").read_text(encoding="utf-8")
    assert "http" not in script
    assert "url(" not in (site / "style.css").read_text(encoding="utf-8")


def test_what_studies_and_papers_say_is_text(full: Path) -> None:
    page = (full / "studies" / "lobes" / "index.html").read_text()
    assert "Phong&#39;s &amp; Ward&#39;s, &lt;as printed&gt;." in page
    assert "Values &amp; more" in page
    assert "0.250000000(1)" in page
    assert "Reading: second" in page
    assert "The words can be read in two ways." in page
    assert "no &lt;luck&gt;" in (full / "studies" / "broken" / "index.html").read_text()
    assert "On &lt;lobes&gt;" in (full / "papers" / "P.html").read_text()
    assert "did not finish: RuntimeError" in (full / "index.html").read_text()


def test_the_overview_counts_verdicts(full: Path, bare: Path) -> None:
    text = (full / "index.html").read_text()
    counts = re.findall(r"</span> ([a-z ]+)</dt><dd>(\d+)</dd>", text)
    assert counts == [
        ("holds", "1"),
        ("holds within", "1"),
        ("fails", "1"),
        ("depends on the reading", "1"),
        ("pending", "1"),
    ]
    # A part has its own verdict, and equal ones are counted.
    assert re.search(r"P2 holds\s*</a>", text)
    counts = re.findall(r"</span> ([a-z ]+)</dt><dd>(\d+)</dd>", (bare / "index.html").read_text())
    assert counts == [("holds", "1"), ("fails", "1"), ("undecided", "1")]


def claim(site: Path, id: str) -> str:
    text = (site / "claims.html").read_text()
    matched = re.search(rf'<article class="claim" id="{id}".*?</article>', text, re.DOTALL)
    assert matched, id
    return matched[0]


def test_claims_show_what_they_rest_on(full: Path) -> None:
    assert "Never shown" not in claim(full, "P1")
    second = claim(full, "P2")
    assert "The words can be read in two ways." in second
    assert "Two readings." in second
    assert 'href="studies/lobes/index.html#figure-second"' in second
    assert 'href="studies/lobes/others.csv"' in second
    # The other part named nothing, and gets the first of each.
    assert 'href="studies/lobes/index.html#figure-picture"' in second
    assert 'href="studies/lobes/values.csv"' in second
    assert "0.500(1)" in second
    assert "Reading: first" in second
    assert "as 2 &gt; 1" in claim(full, "P3")
    assert "nobody has looked" in claim(full, "P4")
    fifth = claim(full, "P5")
    assert 'class="verdict near"' in fifth
    assert "the bound, 1e-9" in fifth


def test_a_site_without_papers_lists_what_studies_claim(bare: Path) -> None:
    assert not (bare / "papers").exists()
    assert "undecided" in claim(bare, "P2")
    assert "holds, fails" in claim(bare, "P2")
    assert "papers" not in (bare / "index.html").read_text()


def test_a_site_without_studies(tmp_path: Path) -> None:
    write_site(tmp_path, [], [], [])
    assert "no claim" in (tmp_path / "claims.html").read_text()
    assert "0 studies" in (tmp_path / "index.html").read_text()


def test_figures_of_a_paper_meet_their_studies(full: Path) -> None:
    text = (full / "papers" / "P.html").read_text()
    first, second, third = re.findall(r'<section class="reproduced".*?</section>', text, re.DOTALL)
    assert "there is nothing to measure" in first
    assert "../studies/lobes/index.html" in second
    assert "They differ." in second
    assert "No study reproduces it." in third
    # A study of a figure is not listed among the others.
    assert 'id="others"' not in text


def test_pages_of_models_show_what_is_known(full: Path, bare: Path) -> None:
    text = (full / "models" / "ward.html").read_text()
    assert "Gregory J. Ward: Measuring and Modeling Anisotropic Reflection." in text
    assert "ward_figure.svg" in text
    assert "0.750000(1)" in text
    assert "12.2" in text
    assert "H at" not in text
    assert text.count("../claims.html#P") == 5
    assert "isotropic roughness" in text
    first = next(iter(albedo.models()))
    text = (full / "models" / f"{first}.html").read_text()
    assert "3 of 5 sets promise it, with at most 0.250000(1)" in text
    assert "_figure.svg" not in text
    # Without the study that measures them, promises are only told.
    text = (bare / "models" / "ward.html").read_text()
    assert "0.750000(1)" not in text
    assert 'id="promises"' in text


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("Ward's albedo", ["ward"]),
        ("Ward-Duer and the rest", ["ward_duer"]),
        ("He-Torrance, Cook-Torrance", ["cook_torrance", "he_torrance"]),
        ("a Blinn-Phong lobe", ["blinn"]),
        ("Schlick's approximation of Fresnel's", []),
        ("Schlick's model", ["schlick"]),
        ("towards, awards and phonograph", []),
        ("An Anisotropic Phong model", []),
        ("max_phong at n = 3", ["max_phong"]),
    ],
)
def test_models_are_found_in_sentences(text: str, found: list[str]) -> None:
    assert pages._named(text, ()) == found


@pytest.mark.parametrize(
    ("verdict", "kind", "rest"),
    [
        ("holds", "holds", ""),
        ("holds within the bound, 4e-9", "holds within", "the bound, 4e-9"),
        ("fails: at 80 degrees", "fails", "at 80 degrees"),
        ("undecided: the error bound reaches", "undecided", "the error bound reaches"),
        ("depends on the reading", "depends on the reading", ""),
    ],
)
def test_verdicts_have_kinds(verdict: str, kind: str, rest: str) -> None:
    assert (pages._kind(verdict), pages._rest(verdict)) == (kind, rest)


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("2", ["2"]),
        ("Figures 5 and 6", ["5", "6"]),
        ("Section 4.2.4, Fig. 3b", ["3b"]),
        ("", []),
    ],
)
def test_figures_are_known_by_their_numbers(text: str, numbers: list[str]) -> None:
    assert pages._numbers(text) == numbers


def test_references_are_whole_and_readable() -> None:
    for key, entry in sources().items():
        line = reference(key)
        assert not set(line) & set("{}\\"), line
        assert entry["year"] in line
        assert "http" not in line
    line = reference("cook1982")
    assert line.startswith("Robert L. Cook, Kenneth E. Torrance: A Reflectance Model")
    assert "ACM Transactions on Graphics 1(1), 7–24, 1982. doi:10.1145/357290.357293" in line


# The study of all models ---------------------------------------------------------------------


class Kept:
    """What a study hands over."""

    def __init__(self) -> None:
        self.tables: dict[str, Any] = {}
        self.figures: dict[str, Any] = {}

    def table(self, name: str, frame: Any, caption: str = "", **_: Any) -> None:
        self.tables[name] = frame

    def figure(self, name: str, figure: Any, caption: str = "") -> None:
        self.figures[name] = figure


@pytest.fixture(scope="module")
def study() -> Iterator[ModuleType]:
    module = ModuleType("albedo_study_model_pages")
    sys.modules[module.__name__] = module
    source = (STUDIES / "model_pages.py").read_text(encoding="utf-8")
    exec(compile(source, "model_pages.py", "exec"), module.__dict__)
    yield module
    del sys.modules[module.__name__]


def look(study: ModuleType) -> Any:
    few = {"curves": 3, "angles": 5, "per_decade": 1, "wide": 4, "high": 4, "pairs": 200}
    return study.Resolution(**few, rtol=1e-6)


def test_lambert_is_his_own_albedo(study: ModuleType) -> None:
    kept = Kept()
    found = study.draw_model(kept, "lambert", look(study))
    frame = kept.tables["lambert_curves"]
    assert ((frame["albedo"] - frame["rho"]).abs() <= frame["albedo_error"]).all()
    assert abs(found["energy"]["largest"] - 1.0) <= found["energy"]["largest_error"]
    assert {row["kept"] for row in found.values()} == {"yes"}
    # Nothing changes towards the horizon, and so nothing is drawn there: two panels and a scale.
    assert len(kept.figures["lambert_figure"].axes) == 3


def test_growth_towards_the_horizon(study: ModuleType) -> None:
    """Ward's albedo goes as the cosine to the power -1/2, Phong's own as its inverse."""
    for name, power in (("ward", 0.5), ("phong_original", 1.0)):
        found = study.draw_model(Kept(), name, look(study))
        horizon = found["horizon"]
        assert (horizon["promised"], horizon["kept"]) == ("no", "not promised")
        # The next term of the expansion is of the order of the larger cosine, or its root.
        slack = math.sqrt(study.NEAR) if power < 1.0 else 10.0 * study.NEAR
        wanted = (study.NEAR / study.NEARER) ** power
        assert abs(horizon["growth"] - wanted) <= horizon["growth_error"] + slack * wanted
        assert found["energy"]["largest"] > 1.0
        assert math.isnan(found["energy"]["of_promises"])
    assert found["reciprocity"]["asymmetry"] > 0.5


def test_promises_are_judged_by_whole_intervals(study: ModuleType) -> None:
    assert study.verdict("no", True, False) == "not promised"
    assert study.verdict("yes", True, False) == "yes"
    assert study.verdict("3 of 4 sets", False, True) == "no"
    assert study.verdict("yes", False, False) == "within the bound"


# In a browser ---------------------------------------------------------------------------------

KINDS = {
    "overview": "index.html",
    "claims": "claims.html",
    "study": "studies/lobes/index.html",
    "many tables": "studies/model_pages/index.html",
    "failure": "studies/broken/index.html",
    "paper": "papers/P.html",
    "model": "models/ward.html",
}

# The contrast of every text with what lies behind it, by the formula of WCAG 2.
CONTRAST = """() => {
  const canvas = document.createElement("canvas").getContext("2d", {willReadFrequently: true});
  const rgba = (color) => {
    canvas.clearRect(0, 0, 1, 1); canvas.fillStyle = color; canvas.fillRect(0, 0, 1, 1);
    return [...canvas.getImageData(0, 0, 1, 1).data];
  };
  const light = ([r, g, b]) => {
    const one = (v) => (v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
    return 0.2126 * one(r) + 0.7152 * one(g) + 0.0722 * one(b);
  };
  const behind = (node) => {
    for (; node; node = node.parentElement) {
      const color = rgba(getComputedStyle(node).backgroundColor);
      if (color[3] === 255) return color;
      if (color[3] !== 0) throw new Error("half transparent");
    }
    return rgba("Canvas");
  };
  const found = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const node = walker.currentNode.parentElement;
    if (!walker.currentNode.data.trim() || !node.checkVisibility()) continue;
    const [a, b] = [light(rgba(getComputedStyle(node).color)), light(behind(node))];
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    found.push([ratio, walker.currentNode.data.trim().slice(0, 40)]);
  }
  return found.sort((a, b) => a[0] - b[0]).slice(0, 3);
}"""

PICTURES = """async () => {
  const found = [...document.images];
  for (const image of found) { image.loading = "eager"; }
  await Promise.all(found.map((image) => image.decode().catch(() => 0)));
  return found.map((image) => image.naturalWidth);
}"""


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    playwright = need_module("playwright.sync_api")
    program = need("chromium", "chromium-browser", "google-chrome")
    with playwright.sync_playwright() as driver:
        flags = ["--no-sandbox", "--disable-dev-shm-usage"]
        browser = driver.chromium.launch(executable_path=program, args=flags)
        try:
            yield browser
        finally:
            browser.close()


@pytest.fixture
def opened(chromium: Any) -> Iterator[Any]:
    """Opens pages from the disk; nothing may be asked for elsewhere, or complain."""
    complaints: list[str] = []
    contexts = []

    def one(path: Path, **options: Any) -> Any:
        context = chromium.new_context(**options)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("requestfailed", lambda request: complaints.append(request.url))

        def asked(request: Any) -> None:
            if not request.url.startswith("file://"):
                complaints.append(request.url)

        page.on("request", asked)
        page.goto(path.as_uri())
        return page

    yield one
    for context in contexts:
        context.close()
    assert complaints == []


@pytest.mark.parametrize("kind", KINDS)
def test_a_page_in_a_browser(full: Path, opened: Any, kind: str) -> None:
    small = {"viewport": {"width": 360, "height": 740}}
    page = opened(full / KINDS[kind], **small, color_scheme="light")
    assert all(width > 0 for width in page.evaluate(PICTURES))
    widths = "[document.documentElement.scrollWidth, document.body.scrollWidth]"
    assert max(page.evaluate(widths)) <= 360
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        worst = page.evaluate(CONTRAST)
        assert worst
        assert worst[0][0] >= 4.5, (scheme, worst)
    # The first key goes to the link that skips the head, and is seen.
    page.keyboard.press("Tab")
    focused = page.evaluate(
        "() => { const a = document.activeElement, box = a.getBoundingClientRect();"
        " return [a.hash, box.left >= 0, getComputedStyle(a).outlineStyle]; }"
    )
    assert focused == ["#main", True, "solid"]


def visible(page: Any, selector: str) -> int:
    count: int = page.locator(f"{selector}:visible").count()
    return count


def test_the_search_filters(full: Path, opened: Any) -> None:
    page = opened(full / "index.html")
    models = len(albedo.models())
    assert visible(page, ".models tbody tr") == models
    for _ in range(40):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.id") == "find":
            break
    assert page.evaluate("document.activeElement.id") == "find"
    page.keyboard.type("He Torr")
    assert visible(page, ".models tbody tr") == 1
    assert visible(page, "#ledger") == visible(page, "#papers") == 0
    assert page.inner_text("#found") == f"1 of {models + 5 + 1 + 4} fit"
    page.fill("#find", "BROKEN")
    assert visible(page, ".studies li") == 1
    assert visible(page, "#models") == 0
    page.fill("#find", "p4")
    assert visible(page, ".ledger li") == 1
    # What a claim says is shown once there are few.
    assert page.is_visible(".ledger li:not([hidden]) .says")
    page.fill("#find", "nothing at all")
    assert page.inner_text("#found").startswith("0 of")
    page.fill("#find", "")
    assert visible(page, ".models tbody tr") == models
    page.keyboard.press("Enter")
    page.locator("h1").click()
    page.keyboard.press("/")
    assert page.evaluate("document.activeElement.id") == "find"


def test_claims_are_filtered_by_verdict_and_paper(full: Path, opened: Any) -> None:
    page = opened(full / "claims.html")
    assert visible(page, ".claim") == 5
    page.select_option("#kind", "fails")
    assert visible(page, ".claim") == 1
    assert page.is_visible("#P3")
    # A link to another one shows it.
    page.evaluate("location.hash = '#P1'")
    page.wait_for_function("!document.getElementById('P1').hidden")
    assert page.input_value("#kind") == ""
    page.select_option("#paper", "P")
    assert visible(page, ".claim") == 5
    page.fill("#find", "ONE small")
    assert visible(page, ".claim") == 0
    page.fill("#find", "small")
    assert visible(page, ".claim") == 1


def test_pages_are_whole_without_the_script(full: Path, opened: Any) -> None:
    page = opened(full / "index.html", java_script_enabled=False)
    assert not page.is_visible("#find")
    assert visible(page, ".ledger li") == 5
    assert visible(page, ".models tbody tr") == len(albedo.models())


def test_manifests_read_back_give_the_same_pages(full: Path, tmp_path: Path) -> None:
    """What a report keeps is all that a page needs."""
    folder = full / "studies" / "lobes"
    manifest = json.loads((folder / "manifest.json").read_text())
    assert render_study(folder, manifest) == (folder / "index.html").read_text()
