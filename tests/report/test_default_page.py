"""What a reader of the default report meets first: few words, few tab stops, a picture, nothing that moves."""

import sys
import threading
import time
import tomllib
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from evalkit.core.run_result import LostTrack
from evalkit.report import write_report

ROOT = Path(__file__).parents[2]
BUILT = ROOT / "reports" / "build" / "default" / "index.html"
SCREENS = {1400: 900, 390: 844}
MISSING_METHOD = "open3d-plane lasting"
MAX_WORDS, MAX_STOPS, MAX_BYTES = 150, 40, 8_000_000

OBSERVER = """
window.shifts = 0;
new PerformanceObserver((list) => { for (const one of list.getEntries()) window.shifts += one.value; })
    .observe({ type: 'layout-shift', buffered: true });
"""
WORDS = """() => {
    const first = document.querySelector('main img, main svg');
    const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    let words = 0;
    while (texts.nextNode()) {
        const one = texts.currentNode;
        if (first.compareDocumentPosition(one) & Node.DOCUMENT_POSITION_FOLLOWING) break;
        if (one.parentElement.checkVisibility()) words += one.data.split(/\\s+/).filter(Boolean).length;
    }
    return words;
}"""
STOPS = """() => [...document.querySelectorAll('a[href], button, input, select, summary, [tabindex]')]
    .filter((one) => one.tabIndex >= 0 && one.checkVisibility()).length"""
PICTURE = "() => document.querySelector('main img, main svg').getBoundingClientRect().bottom"
PAINT = "() => performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? null"


@pytest.fixture(scope="module")
def like_default(compared, tmp_path_factory):
    """Return the page of a comparison like the default report."""
    return write_report(compared, tmp_path_factory.mktemp("default"))


@pytest.fixture(scope="module")
def lost_here(compared, tmp_path_factory):
    """Return the page of the same comparison where KISS-ICP lost the track in the office."""
    lost = LostTrack(5.0, "1.2 m away")
    runs = tuple(
        replace(run, scores=replace(run.scores, lost=lost))
        if (run.method, run.sequence) == ("kiss-icp", "random-office")
        else run
        for run in compared.records
    )
    return write_report(replace(compared, records=runs), tmp_path_factory.mktemp("lost"))


@pytest.fixture(scope="module")
def compared(record, build):
    """Return a comparison with the methods and data sets of the default report, two of them missing here."""
    with (ROOT / "reports" / "default.toml").open("rb") as file:
        experiment = tomllib.load(file)
    methods = [one.get("label", one["use"]) for one in experiment["method"]]
    runs = []
    for one in experiment["sequence"]:
        seeds, label = one.get("seeds", [None])[:3], one.get("label", one["use"])
        missing = {"status": "data-missing", "reason": "fetch it", "answered": 0} if one["use"] == "intel" else {}
        for rank, method in enumerate(methods):
            for seed in seeds:
                scores = {"ate_rmse_m": 0.01 * (1 + rank) * (1.0 + 0.02 * (seed or 0)), "cpu_median_ms": 1.0 + rank}
                how = missing
                if method == MISSING_METHOD:
                    how = {"status": "not-installed", "reason": "install it", "answered": 0}
                own = {} if how else scores
                runs.append(record(method, label, own, seed=seed, error_m=0.01 * (1 + rank), **how))
    comparison = build(runs)
    tuned = {one.get("label", one["use"]): tuple(one.get("tuned_on", ())) for one in experiment["method"]}
    cards = {name: replace(card, tuned_on=tuned[name]) for name, card in comparison.methods.items()}
    degenerate = {"corridor": replace(comparison.sequences["corridor"], degenerate="a bare corridor")}
    return replace(comparison, methods=cards, sequences={**comparison.sequences, **degenerate})


def is_current(page):
    """Whether a page exists and is newer than the code that writes pages."""
    code = (ROOT / "evalkit" / "report").rglob("*.*")
    return page.exists() and page.stat().st_mtime > max(file.stat().st_mtime for file in code if "pyc" not in file.name)


def measure(browser, file, width, capsys):
    """Return and print the figures of a page, opened anew at a width."""
    context = browser.new_context(viewport={"width": width, "height": SCREENS[width]})
    page = context.new_page()
    page.add_init_script(OBSERVER)
    page.goto(file.as_uri())
    page.wait_for_timeout(300)
    names = {"words": WORDS, "stops": STOPS, "picture_px": PICTURE, "paint_ms": PAINT}
    found = {name: page.evaluate(script) for name, script in names.items()}
    found |= {"shift": page.evaluate("window.shifts"), "bytes": file.stat().st_size, "wide": page.evaluate(
        "document.documentElement.scrollWidth")}  # fmt: skip
    context.close()
    text = (
        f"{file.parent.name} at {width} px: {found['words']} words and {found['picture_px']:.0f} px to the end of the "
        f"first picture, {found['stops']} tab stops, {found['bytes'] / 1e6:.2f} MB, layout shift {found['shift']:.3f}, "
        f"first paint after {found['paint_ms'] or 0:.0f} ms"
    )
    with capsys.disabled():
        sys.stdout.write(f"\n{text}\n")
    return found


@pytest.mark.parametrize("width", SCREENS)
@pytest.mark.parametrize("which", ["like the default", "built by make report"])
def test_the_first_screen_is_short_and_shows_a_picture(browser, request, capsys, which, width):
    if which.startswith("built") and not is_current(BUILT):
        pytest.skip("no default report of the present code here: make report")
    file = BUILT if which.startswith("built") else request.getfixturevalue("like_default")
    found = measure(browser, file, width, capsys)
    assert found["words"] <= MAX_WORDS
    assert found["stops"] < MAX_STOPS
    assert found["bytes"] < MAX_BYTES
    assert found["shift"] == 0.0
    assert found["picture_px"] <= SCREENS[width]
    assert found["wide"] <= width


@pytest.mark.parametrize(("media", "width"), [("screen", 1280), ("screen", 1400), ("print", 703)])
def test_the_numbers_fit_the_page_also_where_tracks_were_lost(browser, compared, tmp_path, media, width):
    """A sheet of A4 without its margins is 703 px wide."""
    losses = {0: LostTrack(111.0, "1.2 m away", 131.0), 1: LostTrack(130.0, "1.4 m away")}
    runs = tuple(
        replace(run, scores=replace(run.scores, lost=losses.get(run.seed)))
        if run.sequence in ("random-home", "corridor", "random-warehouse", "random-office") else run
        for run in compared.records
    )  # fmt: skip
    page = browser.new_page(viewport={"width": width, "height": 900})
    page.emulate_media(media=media)
    page.goto(write_report(replace(compared, records=runs), tmp_path).as_uri())
    numbers = page.locator("table").first
    assert "lost in 2 of 3, first at 111 s, 1 found again" in numbers.inner_text()
    assert numbers.evaluate("one => one.offsetWidth") <= numbers.evaluate("one => one.parentElement.clientWidth")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.close()


class SlowPage(BaseHTTPRequestHandler):
    """Sends ``content``, its first part in pieces as from a slow disk or network."""

    content: bytes
    PIECE, PIECES = 3_000, 60

    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.end_headers()
        for start in range(0, self.PIECE * self.PIECES, self.PIECE):
            self.wfile.write(self.content[start : start + self.PIECE])
            time.sleep(0.02)
        self.wfile.write(self.content[self.PIECE * self.PIECES :])

    def log_message(self, *_):
        """Write nothing."""


@pytest.mark.parametrize("width", SCREENS)
def test_nothing_moves_while_the_page_arrives(browser, like_default, width):
    """The answer is drawn at once, not row by row with columns that become narrower."""
    handler = type("Slow", (SlowPage,), {"content": like_default.read_bytes()})
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        context = browser.new_context(viewport={"width": width, "height": SCREENS[width]})
        page = context.new_page()
        page.add_init_script(OBSERVER)
        page.goto(f"http://127.0.0.1:{server.server_port}/")
        page.wait_for_timeout(300)
        assert page.evaluate("window.shifts") == 0.0
        context.close()
        server.shutdown()


PHONE = """() => {
    const box = (one) => one.getBoundingClientRect();
    const lost = document.querySelector('.dots-row[data-of="kiss-icp"] .panel');
    const names = [...document.querySelectorAll('.dots .own-name')];
    const counts = [...document.querySelectorAll('.dots .count')].filter((one) => /[0-9]/.test(one.textContent));
    return {
        key: box(document.querySelector('.legend-line')).bottom, panels: box(lost).top,
        cut: names.filter((one) => one.scrollWidth > one.clientWidth + 1).length, names: names.length,
        counts: counts.filter((one) => one.checkVisibility() && box(one).width > 0).length,
        lost: lost.querySelector('.own-value').innerText,
    };
}"""


def test_on_a_phone_the_key_is_above_names_are_whole_and_losses_are_said(browser, lost_here):
    context = browser.new_context(viewport={"width": 390, "height": 844})
    page = context.new_page()
    page.goto(lost_here.as_uri())
    found = page.evaluate(PHONE)
    context.close()
    assert found["key"] < found["panels"]
    assert found["names"] > 0
    assert found["cut"] == 0
    assert found["counts"] == 12  # all methods but the one that is missing
    assert found["lost"].endswith("lost")


def test_what_is_missing_is_one_pill_and_no_dashes(like_default):
    """What is not on this machine has neither a column nor a row, and no sentence a method."""
    text = like_default.read_text(encoding="utf-8")
    first = text[text.index('id="answer"') : text.index('id="explore"')]
    assert first.count(f"missing here: intel and {MISSING_METHOD}<") == 1
    numbers = first[first.index("At a glance") :]
    for name in ("intel", MISSING_METHOD):
        assert name not in numbers[: numbers.index("</table>")]
        assert name not in first[first.index('class="dots"') : first.index("legend-line")]
    assert "Could not start: all runs on intel (data missing) and open3d-plane lasting (" in first
    assert first.count("data missing") == 1
