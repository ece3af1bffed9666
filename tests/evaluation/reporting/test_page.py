"""The page: its text, no requests to other hosts, and no harm from odd names."""

import copy
import re
import shlex

import pytest
from helpers.finished_runs import ITEM, MANIFEST, VERDICT, emptied, make_flags, make_run
from helpers.pages import Tags

from evaluation import matrix
from evaluation.reporting import page
from evaluation.reporting.announcements import rerun_command
from isac_track.errors import DataError

PANELS = 3 + 3 + 3 + 2 + 2 + 2


@pytest.fixture
def made(page_path):
    return page_path.read_text(encoding="utf-8")


class TestTheFile:
    def test_it_says_what_it_is_and_refers_to_nothing_but_itself(self, made):
        assert made.startswith("<!doctype html>")
        assert "<title>Students03: " in made
        tags = Tags(made)
        assert {
            "name": "viewport",
            "content": "width=device-width, initial-scale=1",
        } in tags.attributes("meta")
        text = re.sub(r"<(script|style)>.*?</\1>|<[^>]*>", "", made, flags=re.DOTALL)
        assert "?" not in text.removeprefix("<!doctype html>")
        assert re.findall(r"<text[^>]*>missed conflicts \(%\)</text>", made)
        for tag, attributes in tags.opened:
            for name in ("href", "src", "xlink:href", "action", "data", "srcset"):
                assert attributes.get(name, "#").startswith(("#", "data:")), (
                    tag,
                    attributes,
                )
        css = "".join(re.findall(r"<style>(.*?)</style>", made, re.DOTALL))
        assert not re.search(r"url\(|@import", css)
        outside = re.findall(r"https?://[^\s\"<]+", made)
        assert set(outside) <= {"http://www.w3.org/2000/svg"}

    def test_every_id_is_there_once_and_every_reference_leads_somewhere(self, made):
        tags = Tags(made)
        ids = [attributes["id"] for _, attributes in tags.opened if "id" in attributes]
        assert len(ids) == len(set(ids))
        wanted = {
            a["href"][1:] for _, a in tags.opened if a.get("href", "").startswith("#")
        }
        wanted |= set(re.findall(r"url\(#([^)]+)\)", made))
        for _, attributes in tags.opened:
            wanted |= set(attributes.get("aria-labelledby", "").split())
        assert wanted <= set(ids)

    def test_figures_have_titles_with_numbers_and_heads_of_tables_can_be_pressed(
        self, made
    ):
        tags = Tags(made)
        svgs, heads = tags.attributes("svg"), tags.attributes("th")
        assert all(svg["viewbox"] for svg in svgs)
        named = [svg for svg in svgs if "role" in svg]
        assert len(named) == PANELS + 5 + 4 + 12
        assert all("aria-label" in svg for svg in named)
        titles = re.findall(r"<title>(.+? to .+?)</title>", made)
        assert len(titles) > PANELS
        assert all(re.search(r"\d", title) for title in titles)
        assert all(head["scope"] == "col" for head in heads)
        sort_buttons = [
            button
            for button in tags.attributes("button")
            if button.get("class") == "sort"
        ]
        assert len(sort_buttons) == len(heads) > 0
        assert len(tags.attributes("caption")) == len(tags.attributes("table"))

    def test_a_folder_that_cannot_be_written_is_named(self, tmp_path):
        with pytest.raises(DataError, match="nowhere"):
            page.write(make_run(tmp_path / "nowhere"), figures=())


class TestWhatItSays:
    def test_the_questions_come_first_and_words_are_spelled_out_where_first_used(
        self, made
    ):
        questions = [
            "robot lose",
            "still leaks",
            "people be linked",
            "descriptors tell",
            "should I share",
        ]
        heads = re.findall(r"<h2>(\d .*?)</h2>", made)
        assert [word in head for word, head in zip(questions, heads, strict=True)] == [
            True
        ] * 5
        assert (
            made.index(heads[-1])
            < made.index('id="plane-1"')
            < made.index('class="gallery"')
        )
        assert made.index('class="gallery"') < made.index('<section id="verdict">')
        text = made[made.index("<body>") :]
        for short, long in (
            ("PLR", "privacy leakage ratio"),
            ("FID", "Fisher information density"),
            ("MEL", "maximum exposure length"),
        ):
            assert text.index(long) < text.index(short), short
        for text in (
            "▲ inflated",
            "· between",
            "split: too few [red]people[/red]",
            "18.7 [18.4, 19.1]",
        ):
            assert text in made
        contents = re.findall(r'<li><a href="#(\w+)">([^<]+)</a></li>', made)
        assert len(contents) == made.count("<section id=")
        for name, title in contents:
            assert re.search(rf'<section id="{name}">\s*<h2>{title}</h2>', made)

    def test_an_empty_run_still_makes_a_page_and_says_that_it_has_no_verdict(self):
        nothing = make_run(**emptied(make_run()), verdict={}, strongest={})
        text = page.render(nothing)
        assert "This run has no verdict" in text
        assert "does not track" not in Tags(text).text
        assert "This run has no linkage attack." in text
        assert "<table>" not in text

    def test_marks_in_a_command_and_a_subject_are_words(self):
        run = make_run(
            verdict={**VERDICT, "items": [{**ITEM, "subject": "</td><img src=x>"}]}
        )
        run.manifest["environment"]["command"] = [
            "matrix.py",
            "--dataset",
            "</code><b>x",
        ]
        tags = Tags(page.render(run))
        assert not tags.attributes("img")
        assert not tags.attributes("b")

    def test_a_simulated_crowd_is_named_first_and_weak_attacks_are_listed(self):
        run = make_run(flags=make_flags())
        run.manifest["dataset"]["simulated"] = True
        text = page.render(run)
        notice = text.index(
            "Simulated crowd: these numbers say nothing about real people."
        )
        assert notice < text.index("What does the robot lose")
        assert (
            "radial_rts (informed) is beaten by radial_rts (blind) at 1 of 47 levels"
            in text
        )
        assert "+0.3 [+0.1, +0.5]" in text


@pytest.mark.parametrize(
    ("given", "stages", "options"),
    [
        (["/somewhere/matrix.py", "--out", "a run"], {},
         "--out 'a run' --dataset students03 --seed 3"),
        (["/bin/isac-track", "matrix", "--seed=3", "--dataset", "walks.csv"], {},
         "--seed=3 --dataset walks.csv"),
        # The command of a run from Python names all that differs from the defaults.
        (["/lib/ipykernel_launcher.py", "-f", "x"], {"privacy.epsilon_m": 0.5},
         ("--preset paper --dataset students03 --seed 3 --mechanism raw"
          " --mechanism fid:1 --predictor least_squares --attack none --task rerelease"
          " --set privacy.epsilon_m=0.5")),
    ],
)  # fmt: skip
def test_the_command_is_the_one_given_with_data_set_and_seed(given, stages, options):
    manifest = copy.deepcopy(MANIFEST)
    manifest["environment"]["command"] = given
    manifest["settings"]["stages"] |= stages
    assert rerun_command(manifest) == f"python -m evaluation.matrix {options}"


def test_the_command_of_a_run_from_python_has_its_identity_and_its_axes():
    manifest = copy.deepcopy(MANIFEST)
    manifest["environment"]["command"] = []
    manifest["dataset"] |= {"name": "walks", "path": "my walks.csv", "format": "obsmat"}
    manifest["identity"] |= {"scenes": 40, "scenes_utility": 40, "seed": 7, "fps": 12.5}
    manifest["settings"] |= {"preset": "smoke", "seed": 7, "tasks": []}
    words = shlex.split(rerun_command(manifest))[3:]
    settings = matrix.settings_from(matrix.parser().parse_args(words))
    assert (settings.preset, settings.seed) == ("smoke", 7)
    assert (settings.dataset, settings.format, settings.fps) == (
        "my walks.csv",
        "obsmat",
        12.5,
    )
    assert settings.mechanisms == ("raw", "fid:1")
    assert settings.tasks == ()


def test_the_command_of_a_run_from_python_adds_where_the_run_added():
    manifest = copy.deepcopy(MANIFEST)
    manifest["environment"]["command"] = []
    manifest["settings"]["named"] = {
        "attacks": ["+my_attack", "+savgol:0.4"],
        "tasks": [],
    }
    words = shlex.split(rerun_command(manifest))[3:]
    assert words[-6:] == [
        "--attack",
        "+my_attack",
        "--attack",
        "+savgol:0.4",
        "--task",
        "none",
    ]
    settings = matrix.settings_from(matrix.parser().parse_args(words))
    assert settings.choice("attacks").named == ("my_attack", "savgol:0.4")
    assert not settings.choice("attacks").replaces
    assert (settings.mechanisms, settings.tasks) == (None, ())
