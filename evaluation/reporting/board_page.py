"""The page of a board: for each world its front, a table, and who knows how much."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Final

import numpy as np

from evaluation.estimates.board_places import Standing, is_control, standings
from evaluation.estimates.cards import AXES, FOLLOWED, KNOWN, MISSED
from evaluation.estimates.families import RAW
from evaluation.plan.protocol import read_protocol
from evaluation.reporting.amounts import (
    PERCENT,
    counted,
    listed,
    tenth_percent,
    whole_percent,
)
from evaluation.reporting.cards import entry_name, gap_line, place_text
from evaluation.reporting.charts import LOOKS, Look, Point, plane_chart
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.markup import HTML, markdown
from evaluation.reporting.names import dataset_title
from evaluation.reporting.table import (
    Cell,
    Column,
    Table,
    build_table,
    number_cell,
    plugin_label,
    text_cell,
)
from evaluation.store.cards import Card, CardScore, seed_label
from isac_track.intervals import Estimate
from isac_track.types import Bools

_LABELS: Final = {
    MISSED: "conflicts missed (%)",
    KNOWN: "person-time known (%)",
    FOLLOWED: "people followed 10 s (%)",
}


_SERIES: Final = (
    "raw, ahead",
    "clean",
    "fid",
    "fid:adding=independent",
    "fixed",
    "fixed:adding=independent",
    "raw, flag",
    "fourier",
    "gp_prior",
    "laplace",
    "least_information",
    "raw, near",
    "ou",
    "qclm",
    "remap",
    "raw, state",
    "raw, window",
    "shaped",
    "correlated",
    "offset",
)
"""Series of built-in plug-ins: the place here is the look, whatever else is there."""
_FEW_NOISES: Final = 2  # From which "every noise" says something.
_MOST_PEOPLE: Final = 0.5


@dataclass(frozen=True, eq=False, slots=True)
class Readings:
    """An entry, and how far each reader gets against it."""

    card: Card
    anchor: str
    sentence: str
    table: Table


@dataclass(frozen=True, eq=False, slots=True)
class World:
    """The entries on a recording, under a law and a seed."""

    title: str
    anchor: str
    finding: str
    figure: Figure
    table: Table
    entries: Sequence[Readings]


@dataclass(frozen=True, eq=False, slots=True)
class Board:
    """All worlds of a board, the first with the most entries."""

    worlds: Sequence[World]
    attacks: Sequence[str]
    extent: str  # How many cards, worlds and attacks.


def make_board(cards: Sequence[Card]) -> Board:
    """Return what the page of some cards shows."""

    def world(card: Card) -> tuple[str, str, str]:
        return card.recording, card.law, seed_label(card.seed, card.seed_commitment)

    groups = [
        (key, list(group)) for key, group in groupby(sorted(cards, key=world), world)
    ]
    groups.sort(key=lambda group: (-len(group[1]), group[0]))
    attacks = dict.fromkeys(attack.spec for card in cards for attack in card.attacks)
    extent = ", ".join(
        [
            counted(len(cards), "card"),
            counted(len(groups), "world"),
            counted(len(attacks), "attack"),
        ]
    )
    looks = _looks(cards)
    return Board([_world(*group, looks) for group in groups], list(attacks), extent)


def render(board: Board) -> str:
    """Return the page."""
    text = HTML.get_template("board.html.j2").render(
        board=board, protocol=read_protocol(), plugin_label=plugin_label
    )
    # A line's end between two elements would be a node of its own.
    return re.sub(r">\n+<", "><", text)


def as_markdown(board: Board) -> str:
    """Return the table of each world in Markdown."""
    parts = [
        f"## {world.title}\n\n{world.finding}\n\n{markdown(world.table)}"
        for world in board.worlds
    ]
    return "\n".join(parts)


def _looks(cards: Sequence[Card]) -> dict[str, Look]:
    """Return the look of each series: built-in ones by name, others what remains."""
    others = sorted({_series(card) for card in cards} - {RAW, *_SERIES})
    looks = {
        name: Look(n % (LOOKS - 1), turn=n // (LOOKS - 1))
        for n, name in enumerate([*_SERIES, *others])
    }
    return looks | {RAW: Look(LOOKS - 1)}


def _world(
    key: tuple[str, str, str], cards: Sequence[Card], looks: Mapping[str, Look]
) -> World:
    recording, law, seed = key
    by_card = list(zip(cards, standings(cards), strict=True))
    by_card.sort(key=lambda pair: (not pair[1].is_front, _value(pair[0], KNOWN)))
    anchor = _anchor("world", *key)
    title = f"{dataset_title(recording)}, {law} error, seed {seed.replace('-', ' ')}"
    ordered, placed = [card for card, _ in by_card], [place for _, place in by_card]
    is_front = np.array([place.is_front for place in placed])
    return World(
        title=title,
        anchor=anchor,
        finding=_finding(ordered, placed),
        figure=_figure(anchor, title, ordered, is_front, looks),
        table=_table(anchor, title, ordered, placed),
        entries=[_readings(card) for card in ordered],
    )


def _finding(cards: Sequence[Card], placed: Sequence[Standing]) -> str:
    """Return how many entries are on the front, and which attacks decide."""
    decisive: dict[str, int] = {}
    for card in cards:
        if not is_control(card):
            name = plugin_label(card.primary[KNOWN].by)
            decisive[name] = decisive.get(name, 0) + 1
    by_count = sorted(decisive.items(), key=lambda item: (-item[1], item[0]))
    named = ", ".join(f"{name} ({count})" for name, count in by_count)
    n_front = sum(place.kind == "front" for place in placed)
    verb = "is" if n_front == 1 else "are"
    total = counted(len(cards), "entry", "entries")
    texts = [f"{n_front} of {total} {verb} on the front."]
    alone = [
        entry_name(card)
        for card, place in zip(cards, placed, strict=True)
        if place.kind == "alone"
    ]
    if alone:
        verb = "is" if len(alone) == 1 else "are each"
        where = "with its form of answer" if n_front else "in this world"
        texts = texts if n_front else []
        texts.append(f"{listed(alone)} {verb} alone {where}, nothing to compare.")
    if named:
        texts.append(f"The strongest adversary, and against how many entries: {named}.")
    return " ".join([*texts, *_followed_always(cards)])


def _followed_always(cards: Sequence[Card]) -> list[str]:
    """Return that most people are followed under every noise, if it is so here."""
    shares = [
        _value(card, FOLLOWED)
        for card in cards
        if card.policy.spec == "everything"
        and card.mechanism.protects
        and card.form == "samples"
    ]
    if len(shares) < _FEW_NOISES or min(shares) < _MOST_PEOPLE:
        return []
    least = whole_percent(min(shares))
    return [f"Every noise alone leaves {least} or more of people followed for 10 s."]


def _table(
    anchor: str, title: str, cards: Sequence[Card], placed: Sequence[Standing]
) -> Table:
    """Return the table of a world: entries on the front first."""
    records = list(zip(cards, placed, strict=True))
    columns = [
        Column("mechanism", lambda record: _link(record[0]), align="left"),
        Column("policy", lambda record: text_cell(record[0].policy.spec), align="left"),
        Column("answer", lambda record: text_cell(record[0].form), align="left"),
        Column("place", lambda record: _place(record[1]), align="left"),
        *(_axis_column(axis) for axis in AXES),
        Column(
            "known best by",
            lambda record: text_cell(plugin_label(record[0].primary[KNOWN].by)),
            align="left",
        ),
        Column("digits", lambda record: _digits(record[0]), align="left"),
        Column("attacks", lambda record: number_cell(len(record[0].attacks), digits=0)),
    ]
    notes = [line] if (line := gap_line(cards)) else []
    return build_table(f"entries-{anchor}", title, records, columns, notes=notes)


def _axis_column(axis: str) -> Column:
    def make_cell(record: tuple[Card, Standing]) -> Cell:
        score = record[0].primary[axis]
        return number_cell(score.value, score.ci_low, score.ci_high, scale=PERCENT)

    return Column(axis, make_cell, "%")


def _link(card: Card) -> Cell:
    return Cell(plugin_label(card.mechanism.spec), link=f"#{_anchor('entry', card)}")


def _place(place: Standing) -> Cell:
    tones = {"front": "good", "unmet": "bad"}
    return Cell(place_text(place), tone=tones.get(place.kind, ""))


def _digits(card: Card) -> Cell:
    if card.digits is None:
        return Cell()
    if card.hides_message:
        return Cell("hide a message", tone="bad")
    return Cell("say nothing")


def _readings(card: Card) -> Readings:
    """Return all readers of an entry, those who know most first."""
    known = [score for score in card.scores if score.metric == "known_share"]
    known.sort(key=lambda score: -(score.value or 0.0))
    others = [score for score in card.scores if score.metric != "known_share"]
    table = build_table(
        f"scores-{_anchor('entry', card)}",
        f"All scores of {card.label}",
        [*known, *others],
        [
            Column("by", lambda score: text_cell(plugin_label(score.by)), align="left"),
            Column("value", _scored),
            Column("metric", lambda score: text_cell(score.metric), align="left"),
            Column("people", lambda score: number_cell(score.n, digits=0)),
        ],
    )
    strongest, *weaker = known
    beside = (
        f"; next {plugin_label(weaker[0].by)}, {_percent(weaker[0])}" if weaker else ""
    )
    sentence = (
        f"{plugin_label(strongest.by)} knows most: {_percent(strongest)} of person-time"
        f"{beside}. Robot {card.primary[MISSED].by} misses least:"
        f" {_percent(card.primary[MISSED])} of conflicts."
        f" {_percent(card.primary[FOLLOWED])} of people are followed for 10 s."
    )
    if card.digits is not None and card.hides_message:
        sentence += (
            f" Low-order digits explain {whole_percent(card.digits.explained)} of where"
            " people are: the release hides a message."
        )
    return Readings(card, _anchor("entry", card), sentence, table)


def _scored(score: CardScore) -> Cell:
    """Return a score in its unit: shares in percent, times in s, alarms per minute."""
    if score.metric == "followed_s":
        return number_cell(score.value, score.ci_low, score.ci_high, unit="s")
    if score.metric == "false_alarms_per_min":
        return number_cell(
            score.value, score.ci_low, score.ci_high, digits=2, unit="/min"
        )
    return number_cell(
        score.value, score.ci_low, score.ci_high, scale=PERCENT, unit="%"
    )


def _percent(score: CardScore) -> str:
    return "-" if score.value is None else tenth_percent(score.value)


def _figure(
    anchor: str,
    title: str,
    cards: Sequence[Card],
    is_front: Bools,
    looks: Mapping[str, Look],
) -> Figure:
    """Return both planes of a world: known, and followed, over missed."""
    names = [_series(card) for card in cards]
    series = list(dict.fromkeys(names))
    panels = []
    for axis in (KNOWN, FOLLOWED):
        curves = []
        for name in series:
            points = [
                Point(
                    looks[name]._replace(hollow=not front),
                    f"{plugin_label(card.mechanism.spec)}, {card.policy.spec}",
                    _estimate(card.primary[MISSED]),
                    _estimate(card.primary[axis]),
                )
                for card, own, front in zip(cards, names, is_front, strict=True)
                if own == name
            ]
            curves.append(sorted(points, key=lambda point: point.x.value))
        chart = plane_chart(curves, x_label=_LABELS[MISSED], y_label=_LABELS[axis])
        panels.append((f"{axis} over missed", chart))
    return Figure(
        name=f"board-{anchor}",
        title=title,
        section="board",
        panels=panels,
        columns=2,
        key={name: looks[name] for name in series},
        caption="",
        note="Filled: on the front of its form of answer. Hollow: beaten, a control, or"
        " an entry that has not met all attacks.",
    )


def _series(card: Card) -> str:
    """Return the name under which entries share colour and shape."""
    mechanism = plugin_label(card.mechanism_name)
    policy = card.policy.spec.partition(":")[0]
    return mechanism if policy == "everything" else f"{mechanism}, {policy}"


def _estimate(score: CardScore) -> Estimate:
    return Estimate(
        _number(score.value), _number(score.ci_low), _number(score.ci_high), n=score.n
    )


def _number(value: float | None) -> float:
    return np.nan if value is None else value


def _value(card: Card, axis: str) -> float:
    return card.primary[axis].value or 0.0


def _anchor(kind: str, *parts: Card | str) -> str:
    """Return a name that a link can lead to."""
    texts = [
        part.file_name.removesuffix(".json") if isinstance(part, Card) else part
        for part in parts
    ]
    return re.sub(r"[^A-Za-z0-9]+", "-", "-".join([kind, *texts]))
