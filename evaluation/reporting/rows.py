"""A finished run as frames, and what is picked from them: mechanisms, levels, sources, sweeps."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd

from evaluation.estimates.families import (
    ADDING_RULES,
    FID,
    FIXED,
    LEVEL_UNITS,
    Family,
    families_in,
)
from evaluation.estimates.keys import Source, Where, level_text
from evaluation.estimates.metrics import METRICS, MISSED_RATE
from evaluation.plan.presets import DISSOCIATION, SHARED
from evaluation.reporting.announcements import scenes_text
from evaluation.reporting.lookups import ENDS, HEADLINE, estimates, family_of
from evaluation.reporting.names import FAMILY_NAMES
from evaluation.reporting.table import Column, level, said, spoken
from isac_track.errors import SettingsError, did_you_mean
from isac_track.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from evaluation.estimates.linkability import LinkedTask
    from evaluation.reporting.headline import Headline
    from evaluation.reporting.table import Table
    from evaluation.verdict.what_to_share import Question, Recommendation
    from isac_track.intervals import Estimate

CONTROLS: Final = frozenset(spec.partition(":")[0] for spec in DISSOCIATION)
"""Families that are there to tear a descriptor and linkability apart."""
# The axis of a mechanism that we do not know is logarithmic from there on.
_LOG_SPAN = 30.0
_LEVELS: Final = {FID: "eta {}", FIXED: "{} m"}
_KNOWN: Final = {
    FID: ("FID noise", "eta (1/(m² s))", True),
    FIXED: ("fixed noise", "added noise (m)", False),
}
STRONGEST: Final = "strongest"
AFTER: Final = "_after"  # Ends the name of a descriptor after the strongest attack.
SHORT: Final = {
    "missed": MISSED_RATE,
    "false_alarm": "false_alarm_rate",
}  # Long to type.
_AT: Final = ["family", "level", "adding"]
_CURVE = 3  # Levels that make one.


@dataclass(frozen=True, eq=False, repr=False)
class Results:
    """A finished run as data frames; the columns are those of the files in `out`."""

    out: Path
    manifest: dict[str, Any]
    summary: pd.DataFrame
    paper_table: pd.DataFrame
    claims: pd.DataFrame
    matched: pd.DataFrame
    frontier: pd.DataFrame
    levels: (
        pd.DataFrame
    )  # What a site gets and pays at each level that it could choose.
    decisions: pd.DataFrame
    curves: pd.DataFrame
    flags: pd.DataFrame
    linkability: pd.DataFrame
    galleries: pd.DataFrame  # Rank 1 and expected rank over the number of candidates.
    speeds: pd.DataFrame  # PLR over net speed.
    verdict: dict[str, Any]  # As in `verdict.json`.
    failed: (
        pd.DataFrame
    )  # Cells that could not be computed, and why; no other table holds them.
    strongest: Mapping[str, Source] = field(default_factory=dict)
    """Of every linkage task the attack that the verdict is about; under "" the reconstruction."""
    conflict_times: pd.DataFrame = field(default_factory=pd.DataFrame)
    """The share of conflicts in which somebody is inside by a time, at every horizon."""
    attacked: pd.DataFrame = field(default_factory=pd.DataFrame)
    """Numbers of the strongest attack against each mechanism, cross-fitted: `strongest.csv`."""
    first_table_of: Callable[[Results], Table] | None = None
    """What makes the table of the first screen, for a notebook."""
    # As in `gallery.parquet`; None without, and of `load`.
    gallery: pd.DataFrame | None = None

    @property
    def measured(self) -> pd.DataFrame:
        """The summary without other assumptions, such as another law: data sets named after it."""
        return self.summary[~self.summary["dataset"].str.startswith(f"{self.dataset}:")]

    def __repr__(self) -> str:
        """Return what run it is, and the table of the first screen in lines."""
        from evaluation.reporting.terminal import aligned  # noqa: PLC0415 - see `load`

        table = self.first_table_of(self) if self.first_table_of else None
        rows = [[cell.full for cell in row] for row in table.rows] if table else []
        heads = [column.head for column in table.columns] if table else []
        return "\n".join(
            [f"<{self._title()}>", *(aligned([heads, *rows], left={0}) if rows else [])]
        )

    def _repr_html_(self) -> str:
        """Return the table of the first screen, and the sentences below it."""
        table = self.first_table_of(self) if self.first_table_of else None
        columns, records = (table.columns, table.rows) if table else ([], [])
        heads = "".join(f"<th>{escape(column.head)}</th>" for column in columns)
        rows = "".join(
            f"<tr>{''.join(f'<td>{escape(cell.full)}</td>' for cell in row)}</tr>"
            for row in records
        )
        grid = f"<table><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table>"
        said = "".join(
            f"<li>{escape(str(one))}</li>" for one in self.verdict.get("answer", ())
        )
        return f"<p>{escape(self._title())}</p>{grid if rows else ''}<ul>{said}</ul>"

    def _title(self) -> str:
        """Return what run it is, in a line."""
        identity, what = self.manifest["identity"], self.dataset
        what += " (simulated people)" * bool(self.manifest["dataset"].get("simulated"))
        shared = self.ours[self.ours["consumer"] == SHARED]
        n_levels = len(shared[["mechanism", "level"]].drop_duplicates())
        failed = f", {len(self.failed)} cells failed" * bool(len(self.failed))
        told = (
            f"{what}, {scenes_text(identity)}, seed {identity['seed']}, {n_levels}"
            " levels"
        )
        return f"Results {self.out}: {told}{failed}"

    def recommendation(self, question: Question | None = None) -> Recommendation:
        """Return which levels may be shared, by default as the first screen asks.

        It is what `evaluation.design` answers: levels that hold, what each costs, who
        breaks it.
        """
        from evaluation.verdict.what_to_share import (  # noqa: PLC0415 - see `load`
            recommend,
        )

        if question is None:
            return self._usual_recommendation
        return recommend(
            self.levels, question, dataset=self.dataset, scenes=self._n_scenes
        )

    @cached_property
    def _usual_recommendation(self) -> Recommendation:
        """The answer to what the first screen asks: a report reads it about twenty times.

        Like the other cached properties it lives as long as these results do.
        """
        from evaluation.verdict.what_to_share import (  # noqa: PLC0415 - see `load`
            default_question,
        )

        return self.recommendation(default_question(self.families))

    @property
    def _n_scenes(self) -> tuple[int, int]:
        """How many scenes were attacked, and how many robots were in."""
        identity = self.manifest["identity"]
        return identity["scenes"], identity.get("scenes_utility", identity["scenes"])

    def frame(
        self, metric: str, *, after: str = "", task: str = "", robot: str = ""
    ) -> pd.DataFrame:
        """Return a metric at every level: family, level, adding, attack, knowledge, value, ci_*.

        Parameters
        ----------
        metric : str
            As in `summary.csv`, in its unit; `missed` and `false_alarm` for short.
        after : str
            Of a descriptor: empty as shared, `strongest` after the attack that the
            verdict is about, or an attack's name, then with every adversary. Of
            linkage: `strongest` (or empty), or a linker's name.
        task : str
            Of linkage; by default the first of the run.
        robot : str
            Predictor whose utility it is; by default the first of the run.

        What adds nothing (raw, clean) has level 0. SettingsError for what the run does
        not have.
        """
        name = SHORT.get(metric, metric)
        if name not in METRICS:
            listed = f"; known: {', '.join(METRICS)}"
            hint = did_you_mean(metric, [*METRICS, *SHORT], quote="'") or listed
            raise SettingsError(f"unknown metric {metric!r}{hint}")
        rows = self.measured
        rows = rows[rows["metric"] == name]
        place = METRICS[name].measured
        tasks = rows["consumer"].map(lambda one: Source(one).task)
        task = task or next(iter(tasks), "")
        rows = rows[tasks == task]
        if place == "predictor":
            who = robot or next(iter(rows["consumer"]), "")
        elif place == "descriptor" and not after:
            who = SHARED
        else:
            who = after
            if after in ("", STRONGEST):
                who, knows = self.strongest.get(task, Source(""))
                rows = rows[rows["knowledge"] == knows]
            who = f"{task}/{who}" if task else who
        found = rows[rows["consumer"] == who]
        if found.empty:
            has = ", ".join(dict.fromkeys(rows["consumer"])) or "nobody in this task"
            raise SettingsError(
                f"the run has no {name} of {who or after!r}; it has that of {has}"
            )
        known = found["mechanism"].map(self.families)
        levels = found["level"].where(known.map(lambda one: one.is_added), 0.0)
        adding = [one.adding for one in known]
        columns = {
            "family": [one.name for one in known],
            "level": levels,
            "adding": adding,
        }
        is_attack = found["knowledge"] != ""
        columns["attack"] = (
            found["consumer"].where(is_attack, "").str.removeprefix(f"{task}/")
        )
        table = pd.DataFrame(
            columns | {one: found[one] for one in ("knowledge", *ENDS)}
        )
        knowledge = found["knowledge"].unique()
        label = Source(who, knowledge[0] if len(knowledge) == 1 else "").label
        if who == SHARED:
            label = "as shared"
        elif place in ("descriptor", "reconstruction", "distance"):
            label = f"after {label}"
        table.attrs["title"] = f"{METRICS[name].title}, {label}"
        return table.reset_index(drop=True)

    def plot(
        self, *, x: str, y: str, task: str = "", robot: str = "", ax: Axes | None = None
    ) -> Axes:
        """Draw one metric over another, with 95 % intervals, and return the axes.

        `x` and `y` are metrics as in `frame`, or `plr_after`: after the strongest
        attack; `x` may be `level`, on a logarithmic axis, where raw is a line in its
        interval. A mechanism looks as on the page. `ax` are the axes to draw on, else
        new ones.
        """
        from matplotlib import (  # noqa: PLC0415 - slow to import, and seldom needed
            pyplot as plt,
        )

        from evaluation.reporting.charts import (  # noqa: PLC0415 - see `load`
            INKS,
            MARKERS,
            looks_of,
        )

        of_y = self._scaled(y, task=task, robot=robot)
        of_x = of_y.assign(value=of_y["level"], ci_low=math.nan, ci_high=math.nan)
        units = (f"{name} {unit}" for name, unit in LEVEL_UNITS.items())
        of_x.attrs["title"] = "; ".join(["level", *units])
        if x != "level":
            of_x = self._scaled(x, task=task, robot=robot)
        both = of_x.merge(of_y, on=_AT, suffixes=("_x", "_y"))
        if ax is None:
            ax = plt.subplots(figsize=(8.0, 4.5), layout="constrained")[1]
        if x == "level":
            ax.set_xscale("log")
        known = {
            (one.name, one.adding): one.mechanism for one in self.families.values()
        }
        looks = looks_of(self.families.values())
        for (family, adding), rows in both.groupby(["family", "adding"], sort=False):
            ordered = rows.sort_values("level")
            (x_at, x_error), (y_at, y_error) = (_bars(ordered, one) for one in "xy")
            mechanism = known[str(family), str(adding)]
            look = looks.get(mechanism, looks["raw"]._replace(hollow=True))  # clean
            name = f"{family} {adding}".rstrip()
            ink: dict[str, Any] = {"color": INKS[look.place], "label": name}
            if x == "level" and not x_at.any():  # raw has none
                ax.axhline(y_at[0], linestyle="--" if look.hollow else ":", **ink)
                (below,), (above,) = y_error
                ax.axhspan(
                    y_at[0] - below, y_at[0] + above, color=ink["color"], alpha=0.1
                )
                continue
            shape: dict[str, Any] = {
                "marker": MARKERS[look.shape],
                "capsize": 2,
                "linewidth": 0.8,
            }
            face = "none" if look.hollow else ink["color"]
            ax.errorbar(
                x_at, y_at, y_error, x_error, markerfacecolor=face, **shape, **ink
            )
        ax.set(xlabel=of_x.attrs["title"], ylabel=of_y.attrs["title"])
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
        return ax

    def _scaled(self, name: str, *, task: str = "", robot: str = "") -> pd.DataFrame:
        """Return a metric as it is shown; after the strongest attack if it ends in `AFTER`."""
        metric = name.removesuffix(AFTER)
        after = STRONGEST if metric != name else ""
        found = self.frame(metric, after=after, task=task, robot=robot)
        found[ENDS] *= METRICS[SHORT.get(metric, metric)].scale
        return found

    @cached_property
    def dataset(self) -> str:
        """Name of the data set."""
        return str(self.manifest["dataset"]["name"])

    @cached_property
    def n_reports(self) -> int:
        """Samples of a track's history, on average."""
        points: float = self.manifest["history"]["points"]
        return round(points)

    @cached_property
    def ours(self) -> pd.DataFrame:
        """The summary without the tasks that have a data set of their own."""
        return self.summary[self.summary["dataset"] == self.dataset]

    @cached_property
    def families(self) -> dict[str, Family]:
        """The mechanisms of the run by name; the manifest says which claim to protect."""
        said = families_in(self.manifest.get("cells", ()))
        return {
            name: replace(one, protects=said[name].protects) if name in said else one
            for name, one in families_in(self.summary).items()
        }

    @cached_property
    def headline(self) -> Headline:
        """The numbers of the first table, which terminal, tables and page read."""
        from evaluation.reporting.headline import headline  # noqa: PLC0415 - see `load`

        return headline(
            self.summary,
            attacks=self.strongest,
            linkability=self.linkability,
            attacked=self.attacked,
            epsilon_m=float(self.manifest["settings"]["stages"]["privacy.epsilon_m"]),
        )

    @cached_property
    def tasks(self) -> list[LinkedTask]:
        """The tasks in which somebody links, of the run's data set or of their own."""
        from evaluation.estimates.linkability import (  # noqa: PLC0415 - see `load`
            dataset_of,
            linked_tasks,
        )

        expected = self.linkability["consumer"].map(
            partial(dataset_of, dataset=self.dataset)
        )
        return linked_tasks(self.linkability[self.linkability["dataset"] == expected])


def _bars(rows: pd.DataFrame, side: str) -> tuple[Floats, Floats]:
    """Return values, (R,), and what the ends of their intervals lie below and above, (2, R)."""
    at, low, high = (rows[f"{name}_{side}"].to_numpy() for name in ENDS)
    return at, np.maximum([at - low, high - at], 0.0)


def short_name(known: Mapping[str, Family], where: Where) -> str:
    """Return a level as it is asked for, its rule short and last."""
    one = family_of(known, where[0])
    values = ",".join(filter(None, [level_text(where[1]), one.parameters]))
    name = f"{spoken(one.family)}:{values}".rstrip(":")
    return name + " ind." * (one.adding == "independent")


def mechanism_columns(known: Mapping[str, Family]) -> list[Column]:
    """Return the columns mechanism, adding rule and level of records that have them."""
    return [
        said("mechanism", lambda record: family_of(known, record["mechanism"]).name),
        said("adding", lambda record: family_of(known, record["mechanism"]).adding),
        Column("level", lambda record: level(record["level"])),
    ]


def by_level(frame: pd.DataFrame) -> dict[Where, dict[Source, dict[str, Estimate]]]:
    """Return the rows of a summary by level, rising, by whose positions, and by metric."""
    found: dict[Where, dict[Source, dict[str, Estimate]]] = {}
    ordered = frame.sort_values("level", kind="stable", na_position="first")
    for key, one in estimates(ordered).items():
        found.setdefault(key.where, {}).setdefault(key.measure.source, {})[
            key.metric
        ] = one
    place = {name: n for n, name in enumerate(frame["mechanism"].unique())}
    return dict(sorted(found.items(), key=lambda one: place[one[0][0]]))


def of_source(frame: pd.DataFrame, source: Source) -> pd.DataFrame:
    """Return the rows of a summary that are of some positions."""
    is_same = frame["knowledge"].fillna("") == source.knowledge
    return frame[is_same & (frame["consumer"] == source.consumer)]


def telling(
    wheres: Iterable[Where], known: Mapping[str, Family], *, controls: bool = True
) -> list[Where]:
    """Return the levels that tell the story, all of them where a run has none of these.

    Those are what has no level, the headline levels of FID and fixed noise, both ends
    of every other mechanism, and all levels of the controls if these are wanted.
    """
    levels: dict[str, list[float | None]] = {}
    for mechanism, at in wheres:
        levels.setdefault(mechanism, []).append(at)
    of = {mechanism: family_of(known, mechanism) for mechanism in levels}
    named = {name for name, _ in HEADLINE}
    told = {
        name: list(dict.fromkeys([ats[0], ats[-1]])) for name, ats in levels.items()
    }
    for mechanism, ats in levels.items():
        if of[mechanism].name in named:
            told[mechanism] = [at for at in ats if (of[mechanism].name, at) in HEADLINE]
        elif of[mechanism].family in CONTROLS:
            told[mechanism] = [at for at in ats if controls or at is None]
    if not any(set(told[name]) - {None} for name in told if of[name].name in named):
        told = levels
    # What adds nothing comes first, what declares no rule last.
    rules = [*ADDING_RULES, ""]
    order = sorted(
        told, key=lambda name: of[name].is_added and 1 + rules.index(of[name].adding)
    )
    return [(name, at) for name in order for at in told[name]]


@dataclass(frozen=True, eq=False, slots=True)
class Scheme:
    """A swept mechanism, and the axis of its level."""

    mechanism: str
    name: str  # Family and parameters, without the adding rule.
    rules: Sequence[
        str
    ]  # Under which it is shown: its own, or all where it declares none.
    title: str
    label: str  # Of the axis.
    log: bool
    place: int  # Of the name among all: what it looks like.

    @property
    def rule_text(self) -> str:
        """Its adding rule in words."""
        return f"{self.rules[0] if len(self.rules) == 1 else 'any'} adding"

    def at(self, level: float) -> str:
        """Return a level with what it is."""
        return _LEVELS.get(self.name, "{}").format(level_text(level))

    def of(self, frame: pd.DataFrame) -> pd.DataFrame:
        """Return the rows of its levels that its axis can show, levels rising."""
        rows = frame[frame["mechanism"] == self.mechanism]
        rows = rows[rows["level"] > 0 if self.log else rows["level"].notna()]
        return rows.sort_values("level")


def schemes(summary: pd.DataFrame, *, as_points: bool = False) -> list[Scheme]:
    """Return what is swept in a run: every mechanism with levels but the controls.

    Of others than FID and fixed noise a few levels, beside what has enough for a curve,
    are no sweep: those are among them only `as_points`. FID and fixed noise come first,
    the others in the order of the run; adding rules of one stand together.
    """
    by_mechanism = summary.dropna(subset="level").groupby("mechanism")
    levels = by_mechanism["level"].agg(["min", "max", "nunique"])
    swept = [
        one for one in families_in(summary).values() if one.mechanism in levels.index
    ]
    swept = [one for one in swept if one.is_added and one.family not in CONTROLS]
    most = min(_CURVE, levels["nunique"].max()) if swept else 0
    if not as_points:
        enough = set(levels.index[levels["nunique"] >= most])
        swept = [one for one in swept if one.name in _KNOWN or one.mechanism in enough]
    names = list(dict.fromkeys([*_KNOWN, *(one.name for one in swept)]))
    swept.sort(
        key=lambda one: (names.index(one.name), ADDING_RULES.index(one.rules[0]))
    )
    found = []
    for one in swept:
        own = levels.loc[[other.mechanism for other in swept if other.name == one.name]]
        low, high = own["min"].min(), own["max"].max()
        title = FAMILY_NAMES.get(one.name, one.name)
        usual = title, f"level of {title}", bool(0 < low <= high / _LOG_SPAN)
        place, axis = names.index(one.name), _KNOWN.get(one.name, usual)
        found.append(Scheme(one.mechanism, one.name, one.rules, *axis, place))
    return found
