"""Sentences about a user's own plug-ins: lines of the first screen, and doubts."""

from collections.abc import Mapping
from typing import Any, Final

from evaluation.estimates.keys import level_text
from evaluation.estimates.own_plugins import ATTACK, LINKER, MECHANISM, PREDICTOR
from evaluation.reporting.amounts import PERCENT, whole_percent
from evaluation.reporting.names import attack_name, robot_name, task_phrase
from evaluation.reporting.rows import Results

# Levels of mechanisms on the screen; tables.txt has all.
_MOST_ROWS: Final = 3
_NOUN: Final = {ATTACK: "attack", LINKER: "attack", PREDICTOR: "predictor"}


def plugin_lines(run: Results) -> list[str]:
    """Return a sentence for each plug-in of the user's own in a run.

    An attack, linker or predictor stands beside the strongest built-in of its kind,
    with the paired difference and its 95 % interval over people; a mechanism has its
    row of numbers.
    """
    records = run.verdict.get("plugins", ())
    rows = [_row(record) for record in records if record["kind"] == MECHANISM]
    compared = [
        _comparison(record) for record in records if record["kind"] != MECHANISM
    ]
    if len(rows) > _MOST_ROWS:
        note = f"{len(rows) - _MOST_ROWS} more levels of your mechanisms: tables.txt"
        rows = [*rows[:_MOST_ROWS], note]
    return [*compared, *rows]


def plugin_doubts(run: Results) -> list[str]:
    """Return the reasons why a user's own plug-in cannot be judged."""
    without_rival: dict[str, list[str]] = {}
    for record in run.verdict.get("plugins", ()):
        if record["kind"] != MECHANISM and not record["rival"]:
            without_rival.setdefault(_NOUN[record["kind"]], []).append(
                f"+{record['plugin']}"
            )
    return [
        f"no built-in {noun} in this run to compare with: add {' '.join(names)}"
        for noun, names in without_rival.items()
    ]


def _comparison(record: Mapping[str, Any]) -> str:
    """Compare a plug-in with the strongest built-in: values and difference."""
    kind, name = record["kind"], _own_name(record["plugin"])
    own = _percent(record["own"])
    if kind == ATTACK:
        sentence = f"{name} rebuilds {own} of positions to epsilon"
        rival = attack_name(record["rival"])
    elif kind == LINKER:
        sentence = f"{name} re-identifies {own} {task_phrase(record['task'])}"
        rival = attack_name(record["rival"])
    else:
        sentence = f"{name} misses {own} of future conflicts{_ahead(record)}"
        rival = robot_name(record["rival"])
    if not record["rival"]:
        return f"Yours: {sentence}; no built-in {_NOUN[kind]} to compare with."
    sentence += f", strongest built-in ({rival}) {_percent(record['other'])}"
    sentence += (
        f", difference {_points(record['difference'])}, mean of {record['levels']}"
        " levels"
    )
    if kind == PREDICTOR:
        sentence += f"; false alarms {_percent(record['alarms'])}"
        sentence += f" against {_percent(record['rival_alarms'])}"
    return f"Yours: {sentence}."


def _own_name(spec: str) -> str:
    """Return the name of a plug-in: its file or the class in it, without folders."""
    place, _, rest = spec.partition(":")
    if "." not in place:
        return spec
    file, (class_name, colon, values) = place.rpartition(".")[2], rest.partition(":")
    usual_class = "".join(part.capitalize() for part in file.split("_"))
    name = file if class_name == usual_class else class_name
    return f"{name}{colon}{values}"


def _row(record: Mapping[str, Any]) -> str:
    """Return the numbers of one level of a mechanism."""
    name = f"{_own_name(record['plugin'])} {level_text(record['level'])}".rstrip()
    parts = []
    if record["robot"]:
        missed = f"{_percent(record['missed'])} of future conflicts{_ahead(record)}"
        parts.append(f"a robot ({robot_name(record['robot'])}) misses {missed}")
    if record["as_sent"]["value"] is not None:
        known = (
            f"{_percent(record['as_sent'])} of positions are known to epsilon as sent"
        )
        if record["attacked"]["value"] is not None:
            known += f", {_percent(record['attacked'])} after attack"
        parts.append(known)
    if record["linked"]["value"] is not None:
        linked = (
            f"{_percent(record['linked'])} are re-identified"
            f" {task_phrase(record['task'])}"
        )
        parts.append(linked)
    return f"Yours: {name}: {'; '.join(parts) or 'nothing was measured'}."


def _ahead(record: Mapping[str, Any]) -> str:
    horizon_s = record["horizon_s"]
    return "" if horizon_s is None else f" within {horizon_s:g} s"


def _percent(interval: Mapping[str, float | None]) -> str:
    value = interval["value"]
    return "an unknown share" if value is None else whole_percent(value)


def _points(interval: Mapping[str, float | None]) -> str:
    """Return a difference of shares in points, with its interval."""
    value, low, high = (interval[end] for end in ("value", "ci_low", "ci_high"))
    if value is None:
        return "unknown"
    if low is None or high is None:
        return f"{PERCENT * value:+.0f} points (too few people for an interval)"
    return (
        f"{PERCENT * value:+.0f} points [{PERCENT * low:+.0f}, {PERCENT * high:+.0f}]"
    )
