"""A figure within a page: no prolog, ids of its own, few bytes, and colours that can change."""

import re

import pytest

from evaluation.reporting import page_svg
from isac_track.errors import DataError


class TestTheInlineFigure:
    SVG = (
        b'<?xml version="1.0"?>\n<!DOCTYPE svg PUBLIC "x" "http://outside">\n'
        b'<svg xmlns:xlink="http://www.w3.org/1999/xlink" width="10pt" viewBox="0 0 10 20">'
        b"<metadata>made by</metadata><defs><style>*{color:red}</style></defs>"
        b'<g id="unused"><!-- secret --><path id="a" d="M 1.23456 2 \nL 3 4 \nz\n" '
        b'style="fill: #ffffff; stroke: #123456"/></g>'
        b'<g id="empty"/><use xlink:href="#a" x="1.98765" clip-path="url(#clip)"/>'
        b'<clipPath id="clip"/></svg>'
    )

    def test_what_is_not_the_figure_goes_and_the_path_is_the_same_in_short(self):
        content, box = page_svg.inline(self.SVG, name="f1", styles=page_svg.Styles())
        assert 'd="M1.23 2L3 4z"' in content
        assert 'x="1.99"' in content
        assert box == "0 0 10 20"
        for gone in ("metadata", "secret", "style", "xlink", "unused", "empty", "http"):
            assert gone not in content

    def test_ids_get_the_figures_name_and_references_follow(self):
        one, _ = page_svg.inline(self.SVG, name="f1", styles=page_svg.Styles())
        other, _ = page_svg.inline(self.SVG, name="f2", styles=page_svg.Styles())
        ids = re.findall(r' id="([^"]+)"', one)
        assert len(ids) == 2
        assert not set(ids) & set(re.findall(r' id="([^"]+)"', other))
        assert set(re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', one)) == {
            (ids[0], ""),
            ("", ids[1]),
        }

    def test_black_and_white_can_change_and_other_colours_stay(self):
        styles = page_svg.Styles()
        content, _ = page_svg.inline(self.SVG, name="f1", styles=styles)
        (name,) = re.findall(r'class="(\w+)"', content)
        assert styles.css() == (f".{name}{{fill:var(--f-ffffff,#ffffff);stroke:#123456}}")
        assert "--f-ffffff:#17191c;" in page_svg.dark_css()
        page_svg.inline(self.SVG, name="f2", styles=styles)
        assert styles.css().count("{") == 1  # written once for all figures

    @pytest.mark.parametrize("broken", [b"", b"<p>no</p>", b"<svg width='3'></svg>"])
    def test_what_is_no_figure_is_refused_by_name(self, broken):
        with pytest.raises(DataError, match="f7"):
            page_svg.inline(broken, name="f7", styles=page_svg.Styles())
