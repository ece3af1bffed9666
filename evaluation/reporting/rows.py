"""What tables and figures pick from the frames of a run: mechanisms, levels and sources."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

from evaluation.analysis.families import ADDING_RULES, CLEAN, RAW, Family
from evaluation.analysis.keys import Source, is_attack
from evaluation.experiment.presets import DISSOCIATION
from evaluation.reporting.table import Column, level, said

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    import pandas as pd

    from evaluation.analysis.keys import Where
    from evaluation.reporting.table import Made

CONTROLS: Final = frozenset(spec.partition(":")[0] for spec in DISSOCIATION)
"""Families that are there to tear a descriptor and linkability apart."""
HEADLINE: Final = (("raw", None), ("fid", 1.0), ("fid", 1000.0), ("fixed", 0.7), ("fixed", 1.0))
"""The few levels that tell the story: mechanism without its adding rule, and level."""
_ORDER = (CLEAN, RAW, "fid", "fixed")


def family_of(known: Mapping[str, Family], mechanism: str) -> Family:
    """Return what is known of a mechanism; of one that is not, its name."""
    return known.get(mechanism, Family(mechanism, mechanism, ""))


def is_control(one: Family) -> bool:
    """Whether a mechanism is there to tear a descriptor and linkability apart."""
    return one.family in CONTROLS


def rank_of(one: Family) -> int:
    """Return where a mechanism stands: no error first, the paper's, strangers', then controls."""
    if is_control(one):
        return len(_ORDER) + 1
    return _ORDER.index(one.family) if one.family in _ORDER else len(_ORDER)


def parameters_text(one: Family) -> str:
    """Return a mechanism's parameters without its adding rule, short."""
    text = one.parameters.replace(",", ", ")
    return text.replace("d_sigma=", "Δσ=").replace("tau_s=", "τ=")


def mechanism_columns(
    known: Mapping[str, Family], where: Callable[[Any], Where] | None = None
) -> list[Made]:
    """Return the columns mechanism, adding rule and level of records, or of where these are."""

    def at(record: Any) -> Where:  # noqa: ANN401 - a row of any frame
        return where(record) if where else (record["mechanism"], record["level"])

    return [
        said("mechanism", lambda record: family_of(known, at(record)[0]).name),
        said("adding", lambda record: family_of(known, at(record)[0]).adding),
        (Column("level"), lambda record: level(at(record)[1])),
    ]


def by_level(frame: pd.DataFrame) -> dict[Where, list[dict[str, Any]]]:
    """Return the rows of each mechanism level, levels rising, mechanisms as in the run."""
    blocks: dict[Where, list[dict[str, Any]]] = {name: [] for name in _wheres(frame)}
    for row in frame.to_dict("records"):
        blocks[_where(row)].append({str(key): value for key, value in row.items()})
    return blocks


def sources_at(rows: Iterable[Mapping[Any, Any]]) -> dict[Source, dict[str, Mapping[Any, Any]]]:
    """Return rows of a summary by whose positions they are of, then by metric."""
    found: dict[Source, dict[str, Mapping[Any, Any]]] = {}
    for row in rows:
        knowledge = row["knowledge"] if isinstance(row["knowledge"], str) else ""
        found.setdefault(Source(row["consumer"], knowledge), {})[row["metric"]] = row
    return found


def attacked(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a summary without what is no adversary's knowledge."""
    return frame.assign(knowledge=frame["knowledge"].where(is_attack(frame), ""))


def telling(
    wheres: Iterable[Where], known: Mapping[str, Family], *, controls: bool = True
) -> list[Where]:
    """Return the levels that tell the story, all of them where a run has none of these.

    Those are what has no level, the headline levels of FID and fixed noise, both ends of every
    other mechanism, and all levels of the controls if these are wanted.
    """
    levels: dict[str, list[float | None]] = {}
    for mechanism, at in wheres:
        levels.setdefault(mechanism, []).append(at)
    wanted = {name: [at for of, at in HEADLINE if of == name] for name, _ in HEADLINE}
    told: dict[str, list[float | None]] = {}
    for mechanism, ats in levels.items():
        one = family_of(known, mechanism)
        if one.name in wanted:
            told[mechanism] = [at for at in ats if at in wanted[one.name]]
        elif is_control(one):
            told[mechanism] = ats if controls else [at for at in ats if at is None]
        else:
            told[mechanism] = ats if len(ats) == 1 else [ats[0], ats[-1]]
    if not any(
        at is not None and at in wanted.get(family_of(known, name).name, ())
        for name, ats in told.items()
        for at in ats
    ):
        told = levels
    order = {name: place for place, name in enumerate(levels)}

    def place(mechanism: str) -> tuple[bool, int, int]:
        one = family_of(known, mechanism)
        rule = ADDING_RULES.index(one.adding) if one.adding in ADDING_RULES else len(ADDING_RULES)
        return one.is_added, rule if one.is_added else 0, order[mechanism]

    return [(name, at) for name in sorted(told, key=place) for at in told[name]]


def _wheres(frame: pd.DataFrame) -> list[Where]:
    ordered = frame[["mechanism", "level"]].drop_duplicates()
    names = list(ordered["mechanism"].unique())
    wheres = [_where(row) for row in ordered.to_dict("records")]
    return sorted(wheres, key=lambda one: (names.index(one[0]), -1.0 if one[1] is None else one[1]))


def _where(row: Mapping[Any, Any]) -> Where:
    return str(row["mechanism"]), None if math.isnan(row["level"]) else float(row["level"])
