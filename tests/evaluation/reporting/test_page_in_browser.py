"""The page in a real browser, opened from its file as its reader would."""

import csv
import io
import re
import shutil

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
sync_api = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed"
)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")

ARGUMENTS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
PHONE, DESK = {"width": 390, "height": 844}, {"width": 1400, "height": 900}
BOXES = """
() => [...document.querySelectorAll('svg[role]')].filter((svg) => svg.checkVisibility())
.map((svg) => {
  const box = svg.getBoundingClientRect();
  const text = svg.querySelector('text');
  const type = text ? getComputedStyle(text) : null;
  const unit = box.width / svg.viewBox.baseVal.width;
  return {name: svg.ariaLabel ?? svg.closest('figure').id, width: box.width,
          left: box.left, right: box.right, is_chart: svg.classList.contains('chart'),
          text_px: type ? unit * parseFloat(type.fontSize) : 0};
})
"""
SIZES = """
() => [document.documentElement.scrollHeight, document.querySelectorAll('*').length]
"""
VALUES = (
    "(table) => [...table.tBodies[0].rows].map((row) =>"
    " row.cells[%d].textContent.trim())"
)
SIDEWAYS = (
    "() => document.documentElement.scrollWidth - document.documentElement.clientWidth"
)


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield chromium
        chromium.close()


@pytest.fixture
def opened(browser, page_path):
    """How to open the page; errors and requests fail at the end."""
    contexts, trouble, requests = [], [], []

    def to_open(viewport=DESK, **options):
        context = browser.new_context(viewport=viewport, **options)
        contexts.append(context)
        tab = context.new_page()
        tab.on(
            "console", lambda message: trouble.append(f"{message.type}: {message.text}")
        )
        tab.on("pageerror", lambda error: trouble.append(str(error)))
        tab.on("request", lambda request: requests.append(request.url))
        tab.goto(page_path.as_uri())
        return tab

    yield to_open
    for context in contexts:
        context.close()
    assert trouble == []
    asked = [url for url in requests if not url.startswith("data:")]
    assert asked == [page_path.as_uri()] * len(contexts)


@pytest.mark.parametrize("viewport", [PHONE, DESK], ids=["phone", "desk"])
def test_the_page_fits_is_readable_and_the_answers_come_first(opened, viewport):
    tab = opened(viewport)
    height_px, n_elements = tab.evaluate(SIZES)
    assert n_elements < 15_000
    assert height_px < 6_000 or viewport is PHONE
    tops = [card.bounding_box()["y"] for card in tab.locator(".card").all()]
    level = tab.locator("#level").bounding_box()["y"]
    assert len(tops) == 6
    assert max(tops) < level
    assert viewport is PHONE or tops[4] < viewport["height"]
    assert tab.evaluate(SIDEWAYS) <= 0
    shown = tab.evaluate(BOXES)
    assert len(shown) == 5 + 2 + 12  # pictures, the planes of one robot, and walks
    for box in shown:
        assert not box["is_chart"] or box["text_px"] > 9, box
    tab.evaluate(
        "() => document.querySelectorAll('details').forEach((d) => d.open = true)"
    )
    assert tab.evaluate(SIDEWAYS) <= 0
    boxes = tab.evaluate(BOXES)
    assert len(boxes) > len(shown)
    for box in boxes:
        assert box["width"] > 90, box
        assert 0 <= box["left"] < box["right"] <= viewport["width"], box


def test_the_record_fits_a_screen(opened):
    tab = opened()
    assert tab.locator("#record").bounding_box()["height"] <= DESK["height"]


@pytest.mark.parametrize(
    ("viewport", "expected"),
    [(PHONE, {True}), (DESK, {True, False})],
    ids=["phone", "desk"],
)
def test_a_table_that_scrolls_says_so_and_no_head_is_empty(opened, viewport, expected):
    tab = opened(viewport)
    tab.evaluate(
        "() => document.querySelectorAll('details').forEach((d) => d.open = true)"
    )
    tab.wait_for_function("() => document.querySelector('.table.wide') !== null")
    frames = tab.locator(".table").evaluate_all(
        "(all) => all.map((one) => { const frame = one.querySelector('.scroll');"
        " return [frame.scrollWidth > frame.clientWidth + 1,"
        " one.querySelector('.cue').checkVisibility()]; })"
    )
    assert {scrolls for scrolls, _ in frames} == expected
    assert all(scrolls == cue for scrolls, cue in frames)
    heads = tab.locator("th").all_text_contents()
    assert heads
    assert all(head.strip() for head in heads)
    captions = tab.locator("caption").evaluate_all(
        "(all) => all.map((one) => one.offsetHeight)"
    )
    assert max(captions) <= 1


def test_another_robot_has_another_plane_and_a_mark_says_what_it_is(opened):
    tab = opened()
    planes = [tab.locator(f"#plane-{n}") for n in (1, 2)]
    assert [plane.is_visible() for plane in planes] == [True, False]
    tab.get_by_label("Kalman", exact=True).check()
    assert [plane.is_visible() for plane in planes] == [False, True]
    marks, named = planes[1].locator(".mark[tabindex]"), tab.locator(".named")
    assert marks.count() > 10
    marks.nth(3).hover()
    first = named.text_content()
    assert re.search(r": missed conflicts \d+\.\d % \[.*, PLR after attack \d", first)
    tab.keyboard.press("Tab")
    marks.nth(4).focus()
    assert named.text_content() == marks.nth(4).text_content() != first


GROUND = "() => getComputedStyle(document.body).backgroundColor"


@pytest.mark.parametrize(
    ("scheme", "ground", "ink"),
    [
        ("light", "rgb(255, 255, 255)", "rgb(27, 29, 32)"),
        ("dark", "rgb(23, 25, 28)", "rgb(232, 232, 230)"),
    ],
)
def test_light_and_dark_are_two_pages_and_print_is_light_no_buttons(
    opened, scheme, ground, ink
):
    tab = opened(color_scheme=scheme)
    assert tab.evaluate(GROUND) == ground
    fill = (
        "() => getComputedStyle(document.querySelector('#fig-after_attack svg')).fill"
    )
    assert tab.evaluate(fill) == ink
    tab.emulate_media(media="print", color_scheme=scheme)
    assert tab.evaluate(GROUND) == "rgb(255, 255, 255)"
    assert not tab.locator(".copy").first.is_visible()
    assert tab.locator("#plane-1 .chart").first.is_visible()


class TestTables:
    PAPER = "#table-paper table"
    OURS = 5

    def unfolded(self, opened, **options):
        tab = opened(**options)
        tab.evaluate(
            "() => document.querySelectorAll('details').forEach((d) => d.open = true)"
        )
        return tab

    def values(self, tab, column):
        return tab.locator(self.PAPER).evaluate(VALUES % column)

    def test_a_click_sorts_by_number_and_another_the_other_way(self, opened):
        tab = self.unfolded(opened)
        head = tab.locator(f"{self.PAPER} th").nth(self.OURS)
        before = self.values(tab, self.OURS)
        numbers = sorted(float(text.split()[0]) for text in before)
        # As words they would be in another order.
        assert sorted(before) != sorted(before, key=lambda text: float(text.split()[0]))
        assert head.get_attribute("aria-sort") is None
        for way, expected in (("ascending", numbers), ("descending", numbers[::-1])):
            head.locator("button").click()
            assert head.get_attribute("aria-sort") == way
            after = [float(text.split()[0]) for text in self.values(tab, self.OURS)]
            assert after == expected
        tab.locator(f"{self.PAPER} th button").first.click()
        assert tab.locator(f"{self.PAPER} th[aria-sort]").count() == 1

    @pytest.mark.parametrize("has_clipboard", [True, False])
    def test_copy_gives_the_table_as_csv_with_or_without_a_clipboard(
        self, opened, has_clipboard
    ):
        options = (
            {"permissions": ["clipboard-read", "clipboard-write"]}
            if has_clipboard
            else {}
        )
        tab = self.unfolded(opened, **options)
        if not has_clipboard:
            tab.evaluate(
                "() => { navigator.clipboard.writeText = () =>"
                " Promise.reject(Error()) }"
            )
        tab.evaluate(
            "() => document.addEventListener('copy', () => { window.copied ="
            " document.activeElement.value ?? String(getSelection()); })"
        )
        tab.locator("#table-claims .copy").click()
        tab.wait_for_function(
            "() => document.getElementById('said').textContent !== ''"
        )
        assert tab.locator("#said").text_content() == "Copied"
        shown = tab.locator("#table-claims table").evaluate(
            "(table) => [...table.rows].map("
            "(row) => [...row.cells].map((cell) => cell.textContent.trim()))"
        )
        assert any("," in cell for row in shown for cell in row)  # to be quoted
        source = "navigator.clipboard.readText()" if has_clipboard else "window.copied"
        assert list(csv.reader(io.StringIO(tab.evaluate(f"() => {source}")))) == shown
