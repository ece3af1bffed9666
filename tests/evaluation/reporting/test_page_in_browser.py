"""The page in a real browser, opened from its file as its reader would."""

import csv
import io
import shutil

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")

ARGUMENTS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
FIGURES = [
    "headline", "fid_threshold", "fixed_error", "operating_points", "after_attack", "linkability",
    "heat_map-rerelease", "dissociation-rerelease", "false_alarms", "track_gallery",
]  # fmt: skip
PHONE, DESK = {"width": 390, "height": 844}, {"width": 1440, "height": 900}
BOXES = """
() => [...document.querySelectorAll('svg[role=img]')].map((svg) => {
  const [own, box] = [svg.getBoundingClientRect(), svg.closest('.scroll').getBoundingClientRect()];
  return {name: svg.closest('figure').id, width: own.width, height: own.height, left: box.left,
          right: box.right, ink: svg.querySelectorAll('path, use').length};
})
"""
VALUES = "(table) => [...table.tBodies[0].rows].map((row) => row.cells[%d].textContent.trim())"
SIDEWAYS = "() => document.documentElement.scrollWidth - document.documentElement.clientWidth"


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield chromium
        chromium.close()


@pytest.fixture
def opened(browser, page_path):
    """How to open the page; at the end nothing may have gone wrong or been asked for."""
    contexts, trouble, requests = [], [], []

    def to_open(viewport=DESK, **options):
        context = browser.new_context(viewport=viewport, **options)
        contexts.append(context)
        tab = context.new_page()
        tab.on("console", lambda message: trouble.append(f"{message.type}: {message.text}"))
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
def test_the_page_fits_and_the_answer_comes_first(opened, viewport):
    tab = opened(viewport)
    boxes = tab.evaluate(BOXES)
    assert {box["name"] for box in boxes} == {f"fig-{name}" for name in FIGURES}
    for box in boxes:
        assert min(box["width"], box["height"]) > 100, box
        assert 0 <= box["left"] < box["right"] <= viewport["width"], box
        assert box["ink"] > 50, box
    sentences = [one.bounding_box() for one in tab.locator(".answer p:not(.more)").all()]
    assert len(sentences) == 3
    assert all(box["y"] + box["height"] < viewport["height"] for box in sentences)
    assert tab.locator("#fig-headline").bounding_box()["y"] < 0.8 * viewport["height"]
    assert tab.evaluate(SIDEWAYS) <= 0
    tab.evaluate("() => document.querySelectorAll('details').forEach((d) => d.open = true)")
    assert tab.evaluate(SIDEWAYS) <= 0


GROUND = "() => getComputedStyle(document.body).backgroundColor"


@pytest.mark.parametrize(
    ("scheme", "ground", "ink"),
    [
        ("light", "rgb(255, 255, 255)", "rgb(0, 0, 0)"),
        ("dark", "rgb(23, 25, 28)", "rgb(232, 232, 230)"),
    ],
)
def test_light_and_dark_are_two_pages_and_print_is_light_without_buttons(
    opened, scheme, ground, ink
):
    tab = opened(color_scheme=scheme)
    assert tab.evaluate(GROUND) == ground
    fill = "() => getComputedStyle(document.querySelector('#fig-headline svg')).fill"
    assert tab.evaluate(fill) == ink
    tab.emulate_media(media="print", color_scheme=scheme)
    assert tab.evaluate(GROUND) == "rgb(255, 255, 255)"
    assert not tab.locator(".copy").first.is_visible()
    assert tab.locator("#table-paper table").is_visible()


class TestTables:
    PAPER = "#table-paper table"
    OURS = 5

    def values(self, tab, column):
        return tab.locator(self.PAPER).evaluate(VALUES % column)

    def test_a_click_sorts_by_number_and_another_the_other_way(self, opened):
        tab = opened()
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

    def test_the_keyboard_does_the_same_and_words_sort_as_words(self, opened):
        tab = opened()
        before = self.values(tab, 0)
        assert before != sorted(before)
        tab.locator(f"{self.PAPER} th button").first.focus()
        tab.keyboard.press("Enter")
        assert self.values(tab, 0) == sorted(before)

    def test_what_is_empty_comes_last_either_way(self, opened):
        tab = opened()
        head = tab.locator(f"{self.PAPER} th button").nth(2)
        for _ in range(2):
            head.click()
            levels = self.values(tab, 2)
            n_empty = levels.count("")
            assert n_empty > 0
            assert levels[-n_empty:] == [""] * n_empty

    @pytest.mark.parametrize("has_clipboard", [True, False])
    def test_copy_gives_the_table_as_csv_with_or_without_a_clipboard(self, opened, has_clipboard):
        options = {"permissions": ["clipboard-read", "clipboard-write"]} if has_clipboard else {}
        tab = opened(**options)
        if not has_clipboard:
            tab.evaluate(
                "() => { navigator.clipboard.writeText = () => Promise.reject(new Error()) }"
            )
        tab.evaluate(
            "() => document.addEventListener('copy', () => {"
            " window.copied = document.activeElement.value ?? String(getSelection()); })"
        )
        tab.locator("#table-claims .copy").click()
        tab.wait_for_function("() => document.getElementById('said').textContent !== ''")
        assert tab.locator("#said").text_content() == "Copied"
        shown = tab.locator("#table-claims table").evaluate(
            "(table) => [...table.rows].map("
            "(row) => [...row.cells].map((cell) => cell.textContent.trim()))"
        )
        assert any("," in cell for row in shown for cell in row)  # to be quoted
        source = "navigator.clipboard.readText()" if has_clipboard else "window.copied"
        assert list(csv.reader(io.StringIO(tab.evaluate(f"() => {source}")))) == shown
