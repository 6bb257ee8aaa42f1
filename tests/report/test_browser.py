"""The page in a real browser: offline, without errors, with keyboard and screen reader, and with a working player."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from evalkit.core.pose import Pose
from evalkit.core.run_result import NO_STEPS
from evalkit.core.scan import Frame, Scan
from evalkit.report import SequenceCard, write_report
from evalkit.report.html.array_encoding import unpack_array
from evalkit.report.html.blocks import Document, Section, Table, Text, render
from evalkit.report.html.shown_scans import load_beams, place_hits

pytestmark = pytest.mark.slow(90)

SCRIPT = "<script>alert(1)</script>"
PLAYER = "#sequence-1 .player"


class Room:
    """60 scans of 90 beams inside a circle of 3 m, with the stamps of the demo's runs, 10 ms apart."""

    def __len__(self):
        return 60

    def frames(self):
        angles = np.linspace(-2.0, 2.0, 90)
        for index in range(60):
            ranges = np.where(np.arange(90) % 10 == 3, np.inf, 3.0 + 0.01 * index)
            yield Frame(Scan(index * 100_000_000, ranges, angles, 0.1, 8.0, 1_000_000), Pose(0.1, 0.02, 0.5))


@pytest.fixture(scope="module")
def page_file(demo, tmp_path_factory):
    same = [
        replace(
            record,
            spec=replace(record.spec, key=f"again-{record.key}", sequence=replace(record.spec.sequence, label=SCRIPT)),
        )
        for record in demo.records[:4]
    ]
    card = SequenceCard(f"A sequence called {SCRIPT}.", "360 beams", "exact", "Author", "MIT")
    same[3] = replace(
        same[3], scores=replace(same[3].scores, errors_m=None), result=replace(same[3].result, steps=NO_STEPS)
    )  # "lost" is a map without a path there
    made = replace(
        demo, records=(*demo.records, *same), sequences={**demo.sequences, SCRIPT: card}, scans={"room": Room}
    )
    return write_report(made, tmp_path_factory.mktemp("browser"))


@pytest.fixture
def open_page(browser, page_file):
    """Return ``open_page(hash, width=..., **options)``: a page that must not log messages or request anything."""
    contexts, complaints = [], []

    def open_(hash_="", width=1300, **options):
        context = browser.new_context(viewport={"width": width, "height": 900}, **options)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("dialog", lambda dialog: complaints.append(f"dialog {dialog.message}"))
        page.on("request", lambda request: requests(request.url))
        page.goto(page_file.as_uri() + hash_)
        return page

    def requests(url):
        if not url.startswith(("data:", page_file.as_uri())):
            complaints.append(f"request {url}")

    yield open_
    for context in contexts:
        context.close()
    assert complaints == []


def explore(page):
    """The page with its second tab and the first sequence open."""
    page.click("#tab-explore")
    if page.locator("#sequence-1").get_attribute("open") is None:
        page.locator("#sequence-1 > summary").click()
    wait_until(page, "location.hash.startsWith('#sequence-1')")
    return page


def player_page(page):
    """The page with the player of the first sequence ready."""
    if not page.locator(PLAYER).is_visible():
        explore(page)
    page.locator(PLAYER).scroll_into_view_if_needed()
    page.wait_for_selector(f"{PLAYER}.ready")
    return page


def wait_until(page, true):
    """Wait for a condition without eval, which the page forbids."""
    for _ in range(6000):
        if page.evaluate(true):
            return
        page.wait_for_timeout(50)
    raise AssertionError(f"never came: {true}")


def scan(page):
    return page.evaluate(f"document.querySelector('{PLAYER}').player.state.scan")


def rows(page, region):
    names = page.locator(f"[aria-label='{region}'] tbody th .method > span:first-of-type")
    return [name.inner_text() for name in names.all() if name.is_visible()]


def test_the_page_logs_nothing_requests_nothing_and_responds_soon(open_page, record_property):
    page = player_page(open_page())
    spent = page.evaluate("performance.now()")
    record_property("player ready after ms", spent)
    assert page.title() == "Demo"


def test_a_name_with_a_script_is_shown_as_text(open_page):
    page = explore(open_page())
    assert SCRIPT in page.locator("h2").all_inner_texts()
    assert page.locator(f"button.pick[value='{SCRIPT}']").inner_text() == SCRIPT


def test_a_click_on_a_heading_sorts_the_table(open_page):
    page = explore(open_page())
    headings = page.get_by_role("region", name="Results on room")
    heading = headings.get_by_role("button", name=re.compile("ATE RMSE"))
    heading.click()
    rising = rows(page, "Results on room")
    heading.click()
    falling = rows(page, "Results on room")
    assert rising[:4] == ["plane", SCRIPT, "paper", "wheel"]
    assert falling[:4] == ["lost", "wheel", "paper", SCRIPT]


def test_the_first_click_sorts_the_best_first_where_higher_is_better(open_page):
    page = explore(open_page())
    page.get_by_role("region", name="Results on room").get_by_role("button", name=re.compile("Map F1")).click()
    assert rows(page, "Results on room")[:4] == ["plane", "paper", "wheel", "lost"]


def test_the_filter_applies_to_tables_and_legends_and_is_kept_in_the_link(open_page):
    page = explore(open_page())
    page.fill("#find", "pa la")
    assert rows(page, "Results on room") == ["plane", "paper"]
    assert page.evaluate("location.hash") == "#sequence-1?find=pa%20la"
    page.fill("#find", "")
    page.locator("button.pick[value=plane]").focus()
    page.keyboard.press("Enter")
    assert rows(page, "Results on room") == ["plane"]
    page.click("#tab-answer")
    assert rows(page, "At a glance") == ["plane"]
    assert page.evaluate("location.hash") == "#answer?only=plane"
    again = player_page(open_page("#sequence-2?only=plane"))
    assert rows(again, "Results on fr079") == ["plane"]
    assert again.locator(f"{PLAYER} .legend tbody tr:visible").count() == 1
    assert again.locator("#sequence-1 .maps figure:visible").count() == 2  # including that of the ground truth
    assert [run["label"] for run in again.evaluate(f"document.querySelector('{PLAYER}').player.state.runs")] == [
        "plane"
    ]
    again.click("#show-all")
    assert len(rows(again, "Results on room")) == 6


def test_the_filter_applies_to_charts(open_page):
    page = player_page(open_page("#sequence-1?only=paper"))
    charts = page.locator("#sequence-1 .chart [data-of]:visible").evaluate_all(
        "all => all.map((one) => one.dataset.of)"
    )
    assert set(charts) == {"paper"}
    page.click("#tab-answer")
    assert set(page.locator(".dots [role=rowheader]:visible").all_inner_texts()) == {"paper"}
    assert page.locator(".scatter g:visible").count() == 1


def test_after_a_filter_of_two_the_comparison_is_as_before(open_page):
    page = player_page(open_page())
    sides = f"['a', 'b'].map((side) => document.querySelector('{PLAYER} select[data-worst=' + side + ']').value)"
    before = page.evaluate(sides)
    for name in ("plane", "lost"):
        page.click(f"button.pick[value={name}]")
    assert page.evaluate(sides) == ["plane", "lost"]
    page.click("#show-all")
    assert page.evaluate(sides) == before
    assert before[0] != before[1]


def test_a_map_of_the_first_screen_opens_the_player_and_plays(open_page):
    page = open_page()
    tile = page.locator(".tile").first
    name = tile.get_attribute("data-of")
    tile.click()
    page.wait_for_selector(".player.ready:visible")
    ready = page.locator(".player.ready").first
    wait_until(page, "document.querySelector('.player.ready').player.timer > 0")
    assert ready.locator("[data-picks=first]").input_value() == name
    assert page.locator("#tab-explore").get_attribute("aria-selected") == "true"


def test_tabs_are_chosen_with_arrow_keys_and_built_when_opened(open_page, page_file):
    page = open_page()
    assert page.locator("#explore .part").count() == 0
    page.locator("#tab-answer").focus()
    page.keyboard.press("ArrowRight")
    page.locator("#explore").wait_for()
    assert page.locator("#explore .part").count() == 4
    assert page.locator("#sequence-1 table").count() == 0  # closed: not built
    page.keyboard.press("ArrowRight")
    page.locator("#appendix").wait_for()
    assert not page.locator("#explore").is_visible()


def test_tab_stops_words_and_size_are_few(open_page, page_file, record_property):
    page = open_page()
    stops = page.evaluate(
        "[...document.querySelectorAll('a[href], button, input, select, summary, [tabindex]')]"
        ".filter((one) => one.tabIndex >= 0 && one.offsetParent).length"
    )
    record_property("tab stops of the first part", stops)
    record_property("page size in bytes", page_file.stat().st_size)
    record_property("first paint after ms", page.evaluate("performance.getEntriesByName('first-paint')[0]?.startTime"))
    assert stops < 40
    player = player_page(page).locator(PLAYER)
    assert player.count() == 1


def test_pointing_at_a_method_colours_it_in_every_chart(open_page):
    page = open_page()
    row = page.locator(".dots-row[data-of=lost]").first
    row.locator("[role=rowheader]").hover()
    pointed = page.locator(".series.pointed").evaluate_all("all => all.map((one) => one.dataset.of)")
    assert set(pointed) == {"lost"}
    assert len(pointed) >= 2
    page.mouse.move(5, 500)
    assert page.locator(".series.pointed").count() == 0


def test_a_copied_link_shows_the_same_scan_again(open_page):
    page = player_page(open_page())
    page.select_option(f"{PLAYER} [data-picks=first]", "plane")
    page.select_option(f"{PLAYER} [data-picks=second]", "truth")
    page.select_option(f"{PLAYER} [data-picks=map]", "own")
    page.check(f"{PLAYER} [data-layer=violations]")
    page.uncheck(f"{PLAYER} [data-layer=estimates]")
    page.uncheck(f"{PLAYER} input.shows[value=lost]")
    page.locator(f"{PLAYER} .stage").focus()
    for key in ("Home", "Shift+ArrowRight", "Shift+ArrowRight", "+", "ArrowUp"):
        page.keyboard.press(key)
    page.click(f"{PLAYER} [data-does=copy]")
    link = page.evaluate("location.hash")
    assert link.startswith("#sequence-1-player?scan=21&by=plane&and=truth&on=own&layers=truth,ghosts,violations&shown=")
    looks = (
        f"(({{ state, view }}) => [state.scan, state.first, state.second, state.map, state.layers,"
        f" state.runs.map((run) => run.label), view.x, view.y, view.scale])(document.querySelector('{PLAYER}').player)"
    )
    again = player_page(open_page(link))
    wait_until(again, f"document.querySelector('{PLAYER}').player.state.scan === 20")
    *exact, x, y, scale = page.evaluate(looks)
    assert again.evaluate(looks) == [
        *exact,
        pytest.approx(x, abs=1e-3),
        pytest.approx(y, abs=1e-3),
        pytest.approx(scale, rel=1e-3),
    ]
    assert again.evaluate("location.hash") == link


def test_a_hand_written_link_needs_only_a_scan_and_a_name(open_page):
    page = player_page(open_page("#sequence-1-player?scan=31&by=wheel&and=nobody&layers="))
    wait_until(page, f"document.querySelector('{PLAYER}').player.state.scan === 30")
    assert page.input_value(f"{PLAYER} [data-picks=first]") == "wheel"
    assert page.input_value(f"{PLAYER} [data-picks=second]") == ""
    assert page.locator(f"{PLAYER} [data-layer]:checked").count() == 0
    page.locator("#sequence-1-player").wait_for()
    page.evaluate("location.hash = '#sequence-1-player?scan=5000'")
    wait_until(page, f"document.querySelector('{PLAYER}').player.state.scan === 59")
    assert page.input_value(f"{PLAYER} [data-picks=first]") == "paper"
    assert page.locator(f"{PLAYER} [data-layer]:checked").count() > 1


def test_opened_details_are_kept_in_the_link(open_page):
    page = explore(open_page())
    page.locator("#sequence-1-everything > summary").click()
    page.locator("#sequence-1-more > summary").click()
    wait_until(page, "location.hash === '#sequence-1?open=sequence-1-everything,sequence-1-more'")
    page.fill("#find", "plane")
    again = open_page(page.evaluate("location.hash"))
    opened = again.locator("details[open]:not([id$=failures])").evaluate_all("all => all.map((one) => one.id)")
    assert opened == ["sequence-1", "sequence-1-everything", "sequence-1-more", "sequence-2"]
    assert rows(again, "Results on fr079") == ["plane"]
    again.evaluate("location.hash = '#sequence-2-results'")
    wait_until(again, "location.hash === '#sequence-2-results?open=sequence-1-everything,sequence-1-more&find=plane'")


def test_columns_of_methods_are_filtered_too(open_page):
    page = explore(open_page("#?only=paper,plane"))
    page.locator("#sequence-1 summary", has_text="All metrics").click()
    table = page.locator("[aria-label='All metrics on room: drift'] table")
    assert table.locator("thead th:visible").all_inner_texts() == ["Drift", "plane", "paper"]
    assert table.locator("tbody tr").nth(1).locator("td:visible").count() == 2


def test_a_number_links_to_its_run(open_page):
    page = explore(open_page())
    page.locator("[aria-label='Results on room'] tbody tr", has_text="paper").locator("td a").first.click()
    row = page.locator("tr.aimed")
    row.wait_for()
    assert "--method 'paper' --seed 0" in row.inner_text()
    row.get_by_role("link", name="paper", exact=False).first.click()
    page.locator("#method-1").wait_for()


def test_keys_step_zoom_and_play(open_page):
    page = player_page(open_page())
    page.locator(f"{PLAYER} .stage").focus()
    for key in ("Home", "ArrowRight", "ArrowRight", "ArrowRight", "ArrowLeft"):
        page.keyboard.press(key)
    assert scan(page) == 2
    page.keyboard.press("Shift+ArrowRight")
    assert scan(page) == 12
    assert page.locator(f"{PLAYER} .at").inner_text() == "scan 13 of 60, 1.20 s"
    assert page.locator(f"{PLAYER} input[type=range]").get_attribute("aria-valuetext") == "scan 13 of 60, 1.20 s"
    scale = f"document.querySelector('{PLAYER}').player.view.scale"
    before = page.evaluate(scale)
    page.keyboard.press("+")
    assert page.evaluate(scale) == pytest.approx(1.5 * before)
    page.keyboard.press("0")
    assert page.evaluate(scale) == pytest.approx(before)
    page.keyboard.press(" ")
    wait_until(page, f"document.querySelector('{PLAYER}').player.state.scan > 14")
    page.keyboard.press(" ")
    stopped = scan(page)
    page.wait_for_timeout(250)
    assert scan(page) == stopped


def test_the_player_works_with_reduced_motion(open_page):
    page = player_page(open_page(reduced_motion="reduce"))
    page.click(f"{PLAYER} [data-does=first]")
    assert page.evaluate("getComputedStyle(document.documentElement).scrollBehavior") == "auto"
    page.click(f"{PLAYER} [data-does=play]")
    wait_until(page, f"document.querySelector('{PLAYER}').player.state.scan > 1")


def test_the_map_reacts_to_wheel_and_drag_only_when_focused(open_page):
    page = player_page(open_page())
    view = f"(({{x, y, scale}}) => [x, y, scale])(document.querySelector('{PLAYER}').player.view)"
    page.locator(f"{PLAYER} .zoom").scroll_into_view_if_needed()
    box = page.locator(f"{PLAYER} canvas.map").bounding_box()
    before = page.evaluate(view)
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.wheel(0, 10)
    page.wait_for_timeout(200)
    assert page.evaluate(view) == before
    box = page.locator(f"{PLAYER} canvas.map").bounding_box()
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 150, box["y"] + 80)
    page.mouse.up()
    moved = page.evaluate(view)
    assert moved[:2] == pytest.approx([before[0] - 50 / before[2], before[1] - 20 / before[2]])
    page.mouse.wheel(0, -200)
    wait_until(page, f"{view}[2] > {moved[2]}")


def test_a_click_on_a_curve_seeks_to_its_time(open_page):
    page = player_page(open_page())
    trace = page.locator(f"{PLAYER} canvas.trace").first
    box = trace.bounding_box()
    trace.click(position={"x": 52 + 0.5 * (box["width"] - 60), "y": 20})
    assert scan(page) in (29, 30)
    error = page.locator(f"{PLAYER} td[data-run=paper][data-quantity=error]").inner_text()
    trial_error = page.evaluate(f"document.querySelector('{PLAYER}').player.recording.runs[0].error[{scan(page)}]")
    assert float(error) == pytest.approx(1000 * trial_error, abs=0.06)


def test_the_page_transforms_scans_like_python(open_page, page_file):
    page = player_page(open_page())
    content = json.loads(page.evaluate(f"document.querySelector('{PLAYER} template').content.textContent"))
    poses = unpack_array(content["runs"][1]["poses"], (60, 3)) * [1e-3, 1e-3, 1e-5]
    stamps = np.arange(60) * 100_000_000
    expected = place_hits(load_beams(Room(), stamps, 10**6), poses, stamps)
    for row in (0, 17, 59):
        got = page.evaluate(
            "([row, selector]) => { const { recording } = document.querySelector(selector).player;"
            " return [...placeScan(recording, recording.runs[1].poses, row)].map((v) => Number.isNaN(v) ? null : v); }",
            [row, PLAYER],
        )
        assert np.array(got, dtype=float).reshape(-1, 2) == pytest.approx(expected[row], abs=1e-9, nan_ok=True)


def test_the_worst_scans_of_two_methods_can_be_selected_by_click(open_page):
    page = player_page(open_page())
    page.select_option(f"{PLAYER} [data-worst=a]", "lost")
    page.select_option(f"{PLAYER} [data-worst=b]", "plane")
    page.select_option(f"{PLAYER} [data-worst=by]", "apart")
    buttons = page.locator(f"{PLAYER} .worst li button")
    assert 1 <= buttons.count() <= 10
    apart = page.evaluate(
        "(selector) => { const { runs } = document.querySelector(selector).player.recording;"
        " const [a, b] = ['lost', 'plane'].map((label) => runs.find((run) => run.label === label).poses);"
        " return Array.from({ length: 60 }, (_, i) => Math.hypot(a[3*i] - b[3*i], a[3*i+1] - b[3*i+1])); }",
        PLAYER,
    )
    buttons.first.click()
    assert scan(page) == int(np.argmax(apart))
    assert page.input_value(f"{PLAYER} [data-picks=first]") == "lost"
    assert page.input_value(f"{PLAYER} [data-picks=second]") == "plane"
    page.select_option(f"{PLAYER} [data-worst=by]", "error")
    assert "more error" in buttons.first.inner_text()


def test_a_map_without_a_path_can_be_shown_with_the_reason(open_page):
    alone = "#sequence-4 .player"
    page = open_page("#sequence-4-player?on=of%20lost")
    page.wait_for_selector(f"{alone}.ready")
    assert page.input_value(f"{alone} [data-picks=map]") == "of lost"
    wait_until(page, f"document.querySelector('{alone}').player.state.map === 'lost'")
    assert "Maps without a path: lost." in page.locator(f"{alone} > .note").inner_text()
    assert page.locator(f"{alone} .legend tbody tr").count() == 3
    page.fill("#find", "pa")
    wait_until(page, f"document.querySelector('{alone}').player.state.map === 'paper'")


def test_every_canvas_shows_content(open_page):
    page = player_page(open_page())
    for canvas in page.locator(f"{PLAYER} canvas").all():
        colours = canvas.evaluate(
            "(c) => new Set(new Uint32Array(c.getContext('2d').getImageData(0, 0, c.width, c.height).data.buffer)).size"
        )
        assert colours > 3


def test_the_colour_scheme_can_be_dark_or_light(open_page):
    page = open_page(color_scheme="light")
    ground = "getComputedStyle(document.body).backgroundColor"
    light = page.evaluate(ground)
    page.click("#theme")
    assert page.evaluate(ground) == light
    page.click("#theme")
    assert page.evaluate(ground) == "rgb(18, 22, 27)"
    page.reload()
    assert page.evaluate(ground) == "rgb(18, 22, 27)"
    page.emulate_media(media="print")
    assert page.evaluate(ground) == "rgb(255, 255, 255)"


def test_print_shows_the_answer_on_two_pages(open_page):
    page = player_page(open_page())
    page.emulate_media(media="print")
    assert page.locator("#answer").is_visible()
    assert not page.locator("#explore").is_visible()
    assert not page.locator("#top").is_visible()
    assert len(re.findall(rb"/Type\s*/Page\b", page.pdf(format="A4"))) <= 2


def test_a_truncated_link_still_opens(open_page):
    page = open_page("#sequence-1?only=%3Cscript&find=%E2%8")
    assert len(rows(page, "Results on room")) == 6


def test_a_page_of_blocks_can_be_dark(browser, tmp_path):
    file = tmp_path / "blocks.html"
    sections = [Section("Found", [Text("Something."), Table(["who", "what"], [["a", "b"]])])]
    file.write_text(render(Document("evalkit", "Blocks", "Of blocks.", sections)), encoding="utf-8")
    page = browser.new_page(color_scheme="dark")
    complaints = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(file.as_uri())
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(18, 22, 27)"
    page.click("#theme")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(246, 247, 249)"
    page.close()
    assert complaints == []


def test_a_long_word_in_a_table_does_not_widen_the_page_of_a_phone(browser, tmp_path):
    file = tmp_path / "blocks.html"
    sections = [Section("Found", [Table(["what", "value"], [["place", "/scratch" * 20]])])]
    file.write_text(render(Document("evalkit", "Blocks", "Of blocks.", sections)), encoding="utf-8")
    page = browser.new_page(viewport={"width": 390, "height": 800})
    page.goto(file.as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    page.close()


def test_a_table_on_a_phone_has_a_wide_caption_and_no_empty_cells(browser, tmp_path):
    file = tmp_path / "blocks.html"
    table = Table(["who", "what", "why"], [["a", "b", ""]], "A sentence that fills one line of a narrow screen")
    file.write_text(render(Document("evalkit", "Blocks", "Of blocks.", [Section("Found", [table])])), encoding="utf-8")
    page = browser.new_page(viewport={"width": 390, "height": 800})
    page.goto(file.as_uri())
    widths = [page.locator(tag).bounding_box()["width"] for tag in ("caption", "table")]
    shown = [one.is_visible() for one in page.locator("td").all()]
    page.close()
    assert widths[0] == pytest.approx(widths[1], abs=1.0)
    assert shown == [True, False]


@pytest.mark.parametrize("width", [1400, 400])
def test_nothing_is_wider_than_the_window(open_page, width):
    page = open_page(width=width)
    for tab in ("answer", "explore", "appendix"):
        page.click(f"#tab-{tab}")
        assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_a_number_on_a_phone_has_the_unit_of_its_column(open_page):
    page = open_page(width=390)
    labels = page.locator("#answer table.wrapping tbody tr:first-child td").evaluate_all(
        "all => all.map(one => one.dataset.label)"
    )
    assert "CPU a scan [ms]" in labels
    assert "Best or tied" in labels


def test_a_long_remark_beside_a_method_fits_a_phone(open_page):
    page = open_page("#explore", width=390)
    chips = page.locator("#explore table.wrapping th .method")
    assert chips.count() > 0
    chips.evaluate_all("""all => all.forEach(one => one.insertAdjacentHTML("beforeend",
        '<span class="chip bad">lost in 4 of 6, first at 32 s, 1 found again</span>'))""")
    page.evaluate("document.querySelectorAll('details').forEach(one => one.open = true)")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.parametrize(
    ("scheme", "tabs"),
    [
        ("light", ("answer", "explore", "appendix")),
        ("dark", ("answer",)),
        pytest.param("dark", ("explore", "appendix"), marks=pytest.mark.thorough),
    ],
)
def test_every_tab_passes_the_accessibility_rules_of_axe(open_page, scheme, tabs):
    axe = pytest.importorskip(
        "axe_playwright_python.sync_playwright", reason="axe is not installed: pip install axe-playwright-python"
    )
    page = open_page(color_scheme=scheme)
    all_rules = {"type": "tag", "values": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"]}
    rules = all_rules if scheme == "light" else {"type": "rule", "values": ["color-contrast"]}  # only colours differ
    told = []
    for tab in tabs:
        page.click(f"#tab-{tab}")
        if tab == "explore":
            player_page(page)
        found = axe.Axe().run(page, options={"runOnly": rules})
        assert "color-contrast" in {rule["id"] for rule in found.response["passes"]}
        told += [
            (tab, v["id"], v["nodes"][0]["target"], v["nodes"][0]["failureSummary"])
            for v in found.response["violations"]
        ]
    assert not told, "\n".join(map(str, told))
