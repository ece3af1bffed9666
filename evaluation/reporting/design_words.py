"""The answer of `evaluation.design`: words, tables, JSON."""

import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import partial
from operator import itemgetter
from typing import Any, TypeAlias

from rich.console import Console

from evaluation.analysis.families import FID, FIXED, LEVEL_UNITS
from evaluation.analysis.keys import Source, level_text
from evaluation.analysis.linkability import remarks
from evaluation.analysis.metrics import DESCRIPTORS, EXPOSURE, METRICS, SUCCESS
from evaluation.analysis.strongest import BEYOND
from evaluation.reporting import table as make
from evaluation.reporting import terminal
from evaluation.reporting.announcements import scenes_text
from evaluation.reporting.markup import paragraphs
from evaluation.reporting.noise_plan import told
from evaluation.reporting.result_tables import MARKS, MEANING
from evaluation.reporting.table import Cell, Column, Table
from evaluation.verdict import choose_level as design
from isac_track.intervals import Estimate
from isac_track.kalman import steady

_Row: TypeAlias = "tuple[str, str, str, design.Level | None]"  # Rule, mechanism, level, numbers.
_ANSWERED = ("met", "chosen", "stricter", "also_meets", "is_saturated")
_CHECKED = ("name", "limit", "measured", "status")
_UNMET = {  # Why a limit does not hold, the surest first.
    "not met": "above the limits of",
    "scenes": "more scenes needed for",
    "people": "more people needed for",
    "cannot say": "cannot be judged by",
}
_LEVEL_NAMES = {FID: "eta", FIXED: "d_sigma"}


def to_json(choice: design.Choice) -> dict[str, Any]:
    """Return the answer as plain values; what is unknown is None."""
    identity, dataset = choice.manifest["identity"], choice.manifest["dataset"]
    limits: dict[str, Any] = {name: choice.limits.given.get(name) for name in design.ASKED}
    schemes = [
        {
            "adding": one.adding,
            "family": one.name,
            **{name: getattr(one, name) for name in _ANSWERED},
            "checks": [
                {name: getattr(check, name) for name in _CHECKED} | {"reason": reason(check)}
                for check in one.checks
            ],
            "reasons": reasons(one),
        }
        for one in choice.schemes
    ]
    answer = {
        "met": choice.met,
        "answer": sentence(choice),
        "out": str(choice.out),
        "dataset": dataset["name"],
        "simulated": bool(dataset["simulated"]),
        "scenes": identity["scenes"],
        "seed": identity["seed"],
        "predictor": choice.predictor,
        "adding": choice.adding,
        "limits": limits | {"as_shared": choice.limits.as_shared},
        "raw": choice.raw,
        "schemes": schemes,
        "notes": notes(choice),
    }
    return {name: _plain(of) for name, of in answer.items()}


def _plain(value: Any) -> Any:  # noqa: ANN401 - what JSON has
    """Return a level, or what it holds, as plain values; what is unknown is None."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, tuple | list):
        return [_plain(one) for one in value]
    if isinstance(value, Estimate):
        value = {name: getattr(value, name) for name in ("value", "ci_low", "ci_high")}
    if is_dataclass(value):
        held = {one.name: getattr(value, one.name) for one in fields(value)}
        value = {}
        for name, of in held.items():
            value |= of if name == "numbers" else {name: of}
    return {name: _plain(of) for name, of in value.items()} if isinstance(value, dict) else value


def reason(check: design.Check) -> str:
    """Return why a target or limit is not met; empty if it is."""
    return "" if check.status == "met" else _said("reason", check=check)[0]


def reasons(scheme: design.Scheme) -> list[str]:
    """Return how the level was chosen, why none stricter, which limits hold, costs and dangers."""
    known = {one.knowledge for one in scheme.chosen.beyond} if scheme.chosen else set()
    return _said("reasons", scheme=scheme, beyond=[one for one in BEYOND if one not in known])


def _said(part: str, **of: Any) -> list[str]:  # noqa: ANN401 - what a macro takes
    return paragraphs(f"design.{part}", _WORDS, **of)


def _told(metric: str, one: Estimate) -> str:
    cell = make.estimated(metric, one)
    return f"{cell.text} {METRICS[metric].unit} {cell.interval}".strip()


def _metric(check: design.Check) -> str:
    return design.METRIC_OF.get(check.name, SUCCESS)


def _what(check: design.Check) -> str:
    return f"{METRICS[_metric(check)].head} {check.whose}".strip()


def _off(check: design.Check) -> str:
    """Return how far the upper end is from the limit."""
    shown = METRICS[_metric(check)]
    off = f"{abs(check.measured.ci_high - check.limit) * shown.scale:.2g}"
    return f"{off} points" if shown.unit == "%" else f"{off} {shown.unit}"


def _at(scheme: design.Scheme, level: design.Level | None) -> str:
    return f"{_symbol(scheme)} = {level_text(level.level) or 'none'}" if level else ""


def _symbol(scheme: design.Scheme) -> str:
    return _LEVEL_NAMES.get(scheme.family.family, "level")


_WORDS: dict[str, Any] = {  # What the template calls.
    **{one.__name__.strip("_"): one for one in (_metric, _what, _off, _told, _at)},
    "symbol_of": _symbol,
    "levels": lambda some: ", ".join(map(level_text, some)),
    "unmet": lambda checks: [reason(one) for one in checks if one.status != "met"],
    "costs": lambda at: [one for one in at.costs.items() if math.isfinite(one[1].value)],
    "source": lambda one: Source(one.attack, one.knowledge).label,
}


def sentence(choice: design.Choice) -> str:
    """Return the plain answer."""
    met, failing, limits = [], dict[str, list[str]](), choice.limits
    for name, schemes in choice.answers.items():
        if why := _failing(schemes):
            failing.setdefault(why, []).append(name)
        else:
            under = " ({})" if schemes[0].family.adding else ""
            at = (f"{_at(one, one.chosen)}{under.format(one.adding)}" for one in schemes)
            met.append(f"{name} {' and '.join(dict.fromkeys(at))}")
    rates = {name: f"{100.0 * limit:.4g} %" for name, limit in limits.of(*design.TARGETS).items()}
    where = " as shared" if limits.as_shared else " after attack"
    return _said(
        "sentence",
        met=met,
        failing=failing,
        simulated=choice.manifest["dataset"]["simulated"],
        missed=rates["missed"],
        false_alarm=rates.get("false_alarm"),
        is_limited=bool(limits.of(*DESCRIPTORS, SUCCESS)),
        where=where * bool(limits.of(*DESCRIPTORS)),
    )[0]


def _failing(schemes: Sequence[design.Scheme]) -> str:
    """Return in a phrase what a mechanism fails under some rule; empty: it meets everything."""
    without = [one for one in schemes if one.chosen is None]
    under = f" with {without[0].adding} adding" if 0 < len(without) < len(schemes) else ""
    unknown = [check.why_unknown for one in without for check in one.missed]
    found_none = "no level meets the targets"
    if unknown and all(unknown):
        found_none = f"cannot be judged ({unknown[0]})"
    why = [f"{found_none}{under}"] * bool(without)
    found: dict[str, str] = {}
    for status, text in _UNMET.items():
        for check in (check for one in schemes for check in one.checks):
            if status == (check.status if math.isnan(check.times_more) else check.asks):
                found.setdefault(METRICS[_metric(check)].head, text)
    for text in _UNMET.values():
        heads = [head for head, its in found.items() if its == text]
        why += [f"{text} {' and '.join(heads)}"] if heads else []
    return ", ".join(why)


def notes(choice: design.Choice) -> list[str]:
    """Return what else is to be known of the run and of the question."""
    schemes, limit, closed = choice.schemes, choice.limits.given.get(EXPOSURE, 0.0), list[str]()
    if 0.0 < limit < 1.0 and not choice.limits.as_shared:
        epsilon_m = float(choice.manifest["settings"]["stages"]["privacy.epsilon_m"])
        dt_s = float(choice.manifest["history"]["interval_s"])
        closed = told(plr=limit, epsilon_m=epsilon_m, q=steady.Q_M2_PER_S3, dt_s=dt_s)[:2]
    raw_misses = [reason(one) for one in choice.raw_checks if one.status == "not met"]
    crowds = [one.task for one in choice.tasks if not one.limited]
    return _said(
        "notes",
        dataset=choice.manifest["dataset"],
        silent=", ".join(one.name for one in schemes if one.name not in choice.answers),
        undeclared=", ".join(dict.fromkeys(one.name for one in schemes if not one.family.adding)),
        raw_misses="; ".join(raw_misses) * any(one.chosen is None for one in schemes),
        closed=" ".join(closed),
        crowds=", ".join(crowds) * (SUCCESS in choice.limits.given),
    )


def show(choice: design.Choice, *, console: Console | None = None) -> None:
    """Print the answer in one sentence, the levels behind it, and why."""
    console, identity = console or terminal.standard_output(), choice.manifest["identity"]
    about = (
        f"{choice.manifest['dataset']['name']}: {scenes_text(identity)}, seed {identity['seed']}; "
        f"predictor {choice.predictor}; 95 % intervals, whose upper ends must meet the limits"
    )
    units = ", ".join(f"{family} {unit}" for family, unit in LEVEL_UNITS.items())
    parts: list[terminal.Part] = [
        (sentence(choice), "bold green" if choice.met else "bold red"),
        "",
        about,
        f"(level: {units})",
        *answer_tables(choice),
    ]
    for scheme in choice.schemes:
        rule = scheme.adding if scheme.family.adding else "any"
        if rule == "any" and scheme.adding != choice.adding[0]:
            continue  # the same as under the first
        parts += ["", (f"{scheme.name}, {rule} adding", "bold cyan")]
        parts += [f"- {reason}" for reason in reasons(scheme)]
        parts += ["- meets everything that was asked"] * scheme.met
    found = notes(choice)
    parts += [*[""] * bool(found), *((f"NOTICE: {note}", "yellow") for note in found)]
    for part in parts:
        if isinstance(part, Table) or not part:
            terminal.show([part], console=console)
            continue
        text, style = (part, "") if isinstance(part, str) else part
        # The further lines of an item stand below its first word.
        below = "  " * text.startswith("- ")
        lines = textwrap.wrap(text, console.width, break_on_hyphens=False, subsequent_indent=below)
        terminal.show([(line, style) for line in lines], console=console)


def answer_tables(choice: design.Choice) -> list[Table]:
    """Return the chosen levels beside raw: as shared, after a reconstruction, and linked."""
    rows: list[_Row] = [("", "raw", "", choice.raw)] if choice.raw else []
    for scheme in choice.schemes:
        at = level_text(scheme.chosen.level) if scheme.chosen else "none"
        rows.append((scheme.adding, scheme.name, at, scheme.chosen))
    keys = [make.said("adding", itemgetter(0)), make.said("", itemgetter(1))]
    keys.append(Column("level", lambda row: make.word(row[2])))
    options: dict[str, Any] = {"marks": MEANING, "n_headings": 1, "n_keys": 3}
    limits = choice.limits.of(*design.METRIC_OF)
    after = {} if choice.limits.as_shared else choice.limits.of(*DESCRIPTORS)
    shared = {name: limit for name, limit in limits.items() if name not in after}
    columns = [*keys, *(_number(name, shared) for name in design.METRIC_OF)]
    found = [make.built("shared", "Utility, and privacy as shared", rows, columns, **options)]
    attacked = [level.after_attack if level else None for *_, level in rows]
    if any(attacked):
        columns = [*keys, *(_number(name, after) for name in DESCRIPTORS)]
        title = f"After the best reconstruction: {_attacks(attacked)}"
        records = [(*row[:3], one) for row, one in zip(rows, attacked, strict=True)]
        found.append(make.built("attacked", title, records, columns, **options))
    columns, about = [], []
    for place, task in enumerate(choice.tasks):
        limit = choice.limits.given.get(SUCCESS) if task.limited else None
        above, cell = _limit(SUCCESS, limit), partial(_rank1, place)
        columns.append(Column(task.task, cell, METRICS[SUCCESS].unit, above=above))
        ran = [one for *_, row in rows if row and (one := row.tasks[place]).attack]
        chances = ", ".join(dict.fromkeys(make.amount(SUCCESS, one.chance).text for one in ran))
        where = "" if task.limited else f", {task.dataset}"
        about += [f"{task.task}{where}: {_attacks(ran)}; chance {chances} %"] if ran else []
    if columns:
        title = "Rank 1 of the strongest attack"
        found.append(make.built("linked", title, rows, [*keys, *columns], notes=about, **options))
    return found


def _number(name: str, limits: Mapping[str, float]) -> Column:
    """Return the column of a number of a level, or of what attacks leave there."""
    metric = design.METRIC_OF[name]
    shown, limit = METRICS[metric], _limit(metric, limits.get(name))

    def cell(row: tuple[str, str, str, design.Level | design.Attacked | None]) -> Cell:
        return make.estimated(metric, row[3].numbers[name] if row[3] else None)

    return Column(shown.head, cell, shown.unit, above=limit)


def _limit(metric: str, limit: float | None) -> str:
    return "" if limit is None else f"<= {limit * METRICS[metric].scale:.4g}"


def _rank1(place: int, row: _Row) -> Cell:
    if row[3] is None:
        return Cell()
    one = row[3].tasks[place]
    marks = (MARKS[name] for name in remarks({"outcome": one.outcome, "invalid": one.invalid}))
    return make.estimated(SUCCESS, one.rank1, mark="".join(marks))


def _attacks(found: Iterable[design.Attacked | design.Linked | None]) -> str:
    labels = [Source(one.attack, one.knowledge).label for one in found if one]
    return ", ".join(dict.fromkeys(labels))
