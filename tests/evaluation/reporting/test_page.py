"""The page: what it says, that it asks nothing of anybody, and that odd names do no harm."""

import copy
import re
from html.parser import HTMLParser

import pytest
from helpers.finished_runs import (
    ITEM,
    MANIFEST,
    VERDICT,
    emptied,
    make_flags,
    make_linkability,
    make_run,
)
from markupsafe import escape

from evaluation.reporting import page
from evaluation.reporting.figures.draw_all import draw_all
from evaluation.reporting.markup import TEMPLATES
from evaluation.reporting.page_command import command
from isac_track.errors import DataError


def draw(run):
    return draw_all(run, folder=run.out / "figures")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    run = make_run(tmp_path_factory.mktemp("run"))
    return page.write(run, drawn=draw(run)).read_text(encoding="utf-8")


class Tags(HTMLParser):
    """Every tag of a page with its attributes, and the text that stands in it."""

    def __init__(self, text):
        super().__init__()
        self.found = []
        self.text = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.text.append(data)

    def of(self, name):
        return [attributes for tag, attributes in self.found if tag == name]


class TestTheFile:
    def test_it_begins_as_a_page_and_says_what_it_is(self, made):
        assert made.startswith("<!doctype html>")
        assert "<title>students03:" in made
        tags = Tags(made)
        assert {"name": "viewport", "content": "width=device-width, initial-scale=1"} in tags.of(
            "meta"
        )

    def test_it_refers_to_nothing_but_itself(self, made):
        for tag, attributes in Tags(made).found:
            for name in ("href", "src", "xlink:href", "action", "data", "srcset"):
                if name in attributes:
                    assert attributes[name].startswith(("#", "data:")), (tag, attributes)
        css = "".join(re.findall(r"<style>(.*?)</style>", made, re.DOTALL))
        assert "url(" not in css
        assert "@import" not in css
        outside = re.findall(r"https?://[^\s\"<]+", made)
        assert set(outside) <= {"http://www.w3.org/2000/svg"}

    def test_every_id_is_there_once_and_every_reference_leads_somewhere(self, made):
        tags = Tags(made)
        ids = [attributes["id"] for _, attributes in tags.found if "id" in attributes]
        assert len(ids) == len(set(ids))
        wanted = {a["href"][1:] for _, a in tags.found if a.get("href", "").startswith("#")}
        wanted |= set(re.findall(r"url\(#([^)]+)\)", made))
        for _, attributes in tags.found:
            wanted |= set(attributes.get("aria-labelledby", "").split())
        assert wanted <= set(ids)

    def test_every_figure_has_a_title_and_words_with_numbers(self, made):
        tags = Tags(made)
        svgs = tags.of("svg")
        assert len(svgs) == 9
        assert all(svg["role"] == "img" and svg["viewbox"] for svg in svgs)
        told = re.findall(r"<title id=.*?>(.*?)</title><desc id=.*?>(.*?)</desc>", made)
        assert len(told) == len(svgs)
        assert all(title for title, _ in told)
        assert all(re.search(r"\d", words) for _, words in told)

    def test_every_head_of_a_table_can_be_pressed_and_says_what_it_is_head_of(self, made):
        tags = Tags(made)
        heads = tags.of("th")
        assert heads
        assert all(head["scope"] == "col" for head in heads)
        assert sum(one.get("class") == "sort" for one in tags.of("button")) == len(heads)
        assert len(tags.of("caption")) == len(tags.of("table"))

    def test_made_twice_it_is_the_same(self, made, tmp_path):
        run = make_run(tmp_path)
        again = page.write(run, drawn=draw(run))
        assert again.read_text(encoding="utf-8") == made

    def test_a_folder_that_cannot_be_written_is_named(self, tmp_path):
        with pytest.raises(DataError, match="nowhere"):
            page.write(make_run(tmp_path / "nowhere"), drawn=[])


class TestWhatItSays:
    def test_the_answer_comes_first(self, made):
        places = [made.index(sentence) for sentence in VERDICT["answer"]]
        assert places == sorted(places)
        assert places[-1] < made.index('id="fig-headline"') < made.index("<nav")

    def test_decisions_are_a_sign_and_a_word(self, made):
        assert '<td class="t bad">✗ does not track</td>' in made
        assert "▲ inflated" in made
        assert "? undecided" in made

    def test_the_paper_stands_beside_ours(self, made):
        assert "18.7 [18.4, 19.1]" in made

    def test_without_a_verdict_it_says_so(self):
        text = page.render(make_run(verdict={}), svgs={})
        assert "This run has no verdict" in text
        assert "does not track" not in Tags(text).text

    def test_an_empty_run_still_makes_a_page(self):
        text = page.render(make_run(**emptied(make_run()), verdict={}), svgs={})
        assert "Nobody links in this run." in text
        assert "<table>" not in text

    def test_a_simulated_crowd_is_called_one_before_anything_is_said(self):
        run = make_run()
        run.manifest["dataset"]["simulated"] = True
        text = page.render(run, svgs={})
        notice = text.index("Simulated crowd: says nothing of real people by itself.")
        assert notice < text.index(VERDICT["answer"][0])

    def test_a_task_that_was_left_out_is_named(self, made):
        assert "split: too few [red]people[/red]" in made

    def test_flags_of_weak_attacks_are_told(self):
        text = page.render(make_run(flags=make_flags()), svgs={})
        assert "radial_rts (informed) is beaten by radial_rts (blind) at 1 of 47 levels" in text
        assert "+0.3 [+0.1, +0.5]" in text

    def test_every_section_is_named_once_and_is_in_the_contents(self, made):
        for name, title in {name: escape(one) for name, one in page.SECTIONS.items()}.items():
            assert f'<li><a href="#{name}">{title}</a></li>' in made
            assert re.search(rf'<section id="{name}">\s*<h2>{title}</h2>', made)


@pytest.fixture(scope="module")
def odd(tmp_path_factory):
    name = "<script>alert(1)</script>"
    frame = make_linkability(dataset=name)
    frame["consumer"] = frame["consumer"].str.replace("shape", "a&b<i>")
    item = {**ITEM, "subject": "</td><img src=x>"}
    run = make_run(
        tmp_path_factory.mktemp("odd"),
        name,
        linkability=frame,
        verdict={**VERDICT, "items": [item]},
        strongest={},
    )
    run.manifest["environment"]["command"] = ["matrix.py", "--dataset", "</code><b>x"]
    return page.write(run, drawn=draw(run)).read_text(encoding="utf-8")


@pytest.mark.slow  # test_untrusted_names.py looks at whole runs
class TestOddNames:
    def test_a_data_set_in_the_shape_of_a_script_is_a_word(self, odd):
        assert "alert(1)" in odd
        assert "<script>alert" not in odd
        assert len(Tags(odd).of("script")) == 1

    def test_an_attack_with_marks_in_its_name_is_a_word(self, odd):
        tags = Tags(odd)
        assert not tags.of("i")
        assert not tags.of("img")
        assert not tags.of("b")
        assert "a&b<i>" in tags.text
        assert "a&amp;b&lt;i&gt;" in odd


class TestTheCommand:
    def test_it_is_the_one_given_with_data_set_and_seed(self):
        assert command(MANIFEST) == (
            "python -m evaluation.matrix --out 'a run' --dataset students03 --seed 3"
        )

    def test_what_was_named_is_not_named_twice(self):
        manifest = copy.deepcopy(MANIFEST)
        manifest["environment"]["command"] = ["/bin/isac-track", "matrix", "--seed=3", "--dataset",
                                              "walks.csv"]  # fmt: skip
        assert command(manifest) == ("python -m evaluation.matrix --seed=3 --dataset walks.csv")

    def test_a_run_from_python_names_all_of_its_axes_and_what_was_changed(self):
        manifest = copy.deepcopy(MANIFEST)
        manifest["environment"]["command"] = ["/lib/ipykernel_launcher.py", "-f", "x"]
        manifest["settings"]["stages"]["privacy.epsilon_m"] = 0.5
        assert command(manifest) == (
            "python -m evaluation.matrix --preset paper --scenes 500 --mechanism raw --mechanism "
            "fid:1 --predictor least_squares --attack none --task rerelease --set "
            "privacy.epsilon_m=0.5 --dataset students03 --seed 3"
        )


def test_the_templates_are_where_the_package_is():
    assert {path.name for path in TEMPLATES.iterdir()} >= {
        "report.html.j2",
        "report.css",
        "report.js",
        "table.html.j2",
        "table.tex.j2",
    }
