"""A finished run as data frames, and selections of levels, sources and sweeps."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd

from attacks.tasks.task_list import RETURNS
from evaluation.estimates.families import (
    ADDING_RULES,
    FID,
    FIXED,
    LEVEL_UNITS,
    Family,
    entry_families,
    families_in,
)
from evaluation.estimates.keys import level_text
from evaluation.estimates.metrics import METRICS, MISSED_RATE
from evaluation.plan.address import (
    Address,
    Where,
    is_track_release,
    parse_consumer,
    parse_dataset,
    plugin_name,
)
from evaluation.plan.presets import DISSOCIATION, SHARED
from evaluation.reporting.announcements import scenes_text
from evaluation.reporting.lookups import ENDS, HEADLINE, estimates, find_family
from evaluation.reporting.names import FAMILY_NAMES
from evaluation.reporting.table import Column, level_cell, text_column
from isac_track.errors import SettingsError, did_you_mean
from isac_track.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from evaluation.estimates.linkability import TaskOutcomes
    from evaluation.reporting.charts import Look
    from evaluation.reporting.headline import Headline
    from evaluation.reporting.table import Table
    from evaluation.verdict.question import Question
    from evaluation.verdict.what_to_share import Recommendation
    from isac_track.intervals import Estimate

CONTROLS: Final = frozenset(map(plugin_name, DISSOCIATION))
"""Families of controls: they separate a descriptor from linkability."""
# Ratio of the levels' ends from which an unknown mechanism has a logarithmic axis.
_LOG_SPAN = 30.0
_LEVEL_PATTERNS: Final = {FID: "eta {}", FIXED: "{} m"}
# By mechanism: title, label of the axis, and whether it is logarithmic.
_PAPER_AXES: Final = {
    FID: ("FID noise", "eta (1/(m² s))", True),
    FIXED: ("fixed noise", "added noise (m)", False),
}
STRONGEST: Final = "strongest"
# Suffix of the name of a descriptor after the strongest attack.
AFTER: Final = "_after"
SHORT: Final = {"missed": MISSED_RATE, "false_alarm": "false_alarm_rate"}
"""Metrics by a name that is quick to type."""
_LEVEL_KEYS: Final = ["family", "level", "adding"]
_LEAST_LEVELS = 3  # Levels that make a curve.


@dataclass(frozen=True, eq=False, repr=False)
class Results:
    """A finished run as data frames; the columns are those of the files in `out`.

    Attributes
    ----------
    out : Path
        Run folder.
    manifest : dict
        Settings, versions and data of the run, and its cells: `manifest.json`.
    summary : DataFrame
        Every metric with its interval: `summary.csv`.
    paper_table : DataFrame
        Numbers of the paper beside ours: `paper_table.csv`.
    claims : DataFrame
        Claims of the paper, and what the run says of them: `paper_claims.csv`.
    matched : DataFrame
        Mechanisms at equal cost or equal PLR: `matched.csv`.
    frontier : DataFrame
        Privacy at a target of utility: `frontier.csv`.
    levels : DataFrame
        Privacy and cost at each level that a site could choose: `levels.csv`.
    decisions : DataFrame
        Misses of each predictor at equal false alarms: `decisions.csv`.
    curves : DataFrame
        Misses over false alarms: `curves.csv`.
    flags : DataFrame
        Attacks that are weaker than they should be: `flags.json`.
    linkability : DataFrame
        Outcome of every linkage attack: `linkability.csv`.
    galleries : DataFrame
        Rank 1 and expected rank over the number of candidates: `gallery.csv`.
    speeds : DataFrame
        PLR over net speed: `by_speed.csv`.
    verdict : dict
        Decisions of the run: `verdict.json`.
    failed : DataFrame
        Cells that could not be computed, and why: `failed.csv`. No other table holds
        them.
    strongest : mapping
        By linkage task the attack of the verdict; under ``""`` that of reconstruction.
    conflict_times : DataFrame
        Share of conflicts in which an agent is inside by a time, at every horizon:
        `conflict_times.csv`.
    attacked : DataFrame
        The strongest attack against each mechanism, cross-fitted: `strongest.csv`.
    make_first_table : callable or None
        Makes the table of the first screen, for a notebook.
    gallery : DataFrame or None
        A few walks to be drawn: `gallery.parquet`. None without them, and always after
        `load`.
    """

    out: Path
    manifest: dict[str, Any]
    summary: pd.DataFrame
    paper_table: pd.DataFrame
    claims: pd.DataFrame
    matched: pd.DataFrame
    frontier: pd.DataFrame
    levels: pd.DataFrame
    decisions: pd.DataFrame
    curves: pd.DataFrame
    flags: pd.DataFrame
    linkability: pd.DataFrame
    galleries: pd.DataFrame
    speeds: pd.DataFrame
    verdict: dict[str, Any]
    failed: pd.DataFrame
    strongest: Mapping[str, Address] = field(default_factory=dict)
    conflict_times: pd.DataFrame = field(default_factory=pd.DataFrame)
    attacked: pd.DataFrame = field(default_factory=pd.DataFrame)
    make_first_table: Callable[[Results], Table] | None = None
    gallery: pd.DataFrame | None = None

    @property
    def measured(self) -> pd.DataFrame:
        """The summary without worlds, such as another error law.

        The data sets of worlds are named `DATASET:WORLD`.
        """
        rows = self.without_policy
        is_elsewhere = [
            name != self.dataset and bool(parse_dataset(name).world)
            for name in rows["dataset"]
        ]
        return rows[~np.array(is_elsewhere, dtype=bool)]

    @property
    def without_policy(self) -> pd.DataFrame:
        """The summary of scenes and windows: no patrols, no people who come back.

        Rows of patrols have a disclosure policy, and those of tracks a release.
        """
        return self.summary[~(self._has_policy | self._is_return)]

    @property
    def patrols(self) -> pd.DataFrame:
        """The rows of the summary that are about disclosure policies of patrols."""
        return self.summary[self._has_policy & ~self._is_tracked]

    @property
    def returns(self) -> pd.DataFrame:
        """The rows of the summary that are about people who come back."""
        return self.summary[self._is_return]

    @property
    def has_scenes(self) -> bool:
        """Whether the run has scenes; else it is about people who come back alone."""
        return not self.manifest.get("no_scenes")

    @property
    def _is_return(self) -> pd.Series[bool]:
        """Which rows of the summary are of the task of people who come back."""
        return self.summary["consumer"].str.startswith(f"{RETURNS.name}/")

    @property
    def tracks(self) -> pd.DataFrame:
        """The rows of the summary that are about tracks of a network's detections."""
        return self.summary[self._is_tracked]

    @property
    def _is_tracked(self) -> pd.Series[bool]:
        """Which rows of the summary are of a release of tracks."""
        if "policy" not in self.summary:
            return self._has_policy
        texts = self.summary["policy"]
        known = [text for text in texts.unique() if isinstance(text, str)]
        return texts.isin([text for text in known if is_track_release(text)])

    @property
    def _has_policy(self) -> pd.Series[bool]:
        """Which rows of the summary have a policy; none if it has no such column."""
        if "policy" not in self.summary:
            return pd.Series(data=False, index=self.summary.index)
        return self.summary["policy"].notna() & (self.summary["policy"] != "")

    def __repr__(self) -> str:
        """Return the title of the run, and the table of the first screen in lines."""
        from evaluation.reporting.terminal import aligned  # noqa: PLC0415 - see `load`

        table = self.make_first_table(self) if self.make_first_table else None
        rows = [[cell.full for cell in row] for row in table.rows] if table else []
        heads = [column.head for column in table.columns] if table else []
        lines = aligned([heads, *rows], left={0}) if rows else []
        return "\n".join([f"<{self._title()}>", *lines])

    def _repr_html_(self) -> str:
        """Return the table of the first screen, and the sentences below it."""
        table = self.make_first_table(self) if self.make_first_table else None
        columns, records = (table.columns, table.rows) if table else ([], [])
        heads = "".join(f"<th>{escape(column.head)}</th>" for column in columns)
        rows = "".join(
            f"<tr>{''.join(f'<td>{escape(cell.full)}</td>' for cell in row)}</tr>"
            for row in records
        )
        grid = f"<table><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table>"
        sentences = "".join(
            f"<li>{escape(str(sentence))}</li>"
            for sentence in self.verdict.get("answer", ())
        )
        title = f"<p>{escape(self._title())}</p>"
        return f"{title}{grid if rows else ''}<ul>{sentences}</ul>"

    def _title(self) -> str:
        """Return folder, data set and size of the run, in a line."""
        identity, people = self.manifest["identity"], self.dataset
        if self.manifest["dataset"].get("simulated"):
            people += " (simulated people)"
        shared = self.ours[self.ours["consumer"] == SHARED]
        n_levels = len(shared[["mechanism", "level"]].drop_duplicates())
        failed = f", {len(self.failed)} cells failed" if len(self.failed) else ""
        n_scenes = scenes_text(identity)
        if not self.has_scenes:
            n_scenes = "no scenes"
            n_levels = len(self.returns[["mechanism", "level"]].drop_duplicates())
        size = f"{n_scenes}, seed {identity['seed']}, {n_levels} levels"
        return f"Results {self.out}: {people}, {size}{failed}"

    def recommendation(self, question: Question | None = None) -> Recommendation:
        """Return which levels may be shared, by default as the first screen asks.

        `evaluation.design` gives the same answer: the levels that hold, the cost of
        each, and the adversaries that break it.
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
        """The answer to the question of the first screen.

        Cached, as a report reads it about twenty times. It lives as long as these
        results do, like the other cached properties.
        """
        from evaluation.verdict.question import default_question  # noqa: PLC0415 - see `load`

        return self.recommendation(default_question(self.families))

    @property
    def _n_scenes(self) -> tuple[int, int]:
        """Numbers of scenes: attacked, and with robots."""
        identity = self.manifest["identity"]
        return identity["scenes"], identity.get("scenes_utility", identity["scenes"])

    def frame(
        self, metric: str, *, after: str = "", task: str = "", robot: str = ""
    ) -> pd.DataFrame:
        """Return a metric at every level, as a frame.

        Its columns are family, level, adding, attack, knowledge, value, ci_low and
        ci_high.

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

        Mechanisms that add nothing (raw, clean) have level 0. Raises SettingsError for
        a metric, attack, task or robot that the run does not have.
        """
        name = SHORT.get(metric, metric)
        if name not in METRICS:
            listed = f"; known: {', '.join(METRICS)}"
            hint = did_you_mean(metric, [*METRICS, *SHORT], quote="'") or listed
            raise SettingsError(f"unknown metric {metric!r}{hint}")
        rows = self.measured
        rows = rows[rows["metric"] == name]
        place = METRICS[name].kind
        row_tasks = rows["consumer"].map(lambda consumer: parse_consumer(consumer).task)
        task = task or next(iter(row_tasks), "")
        rows = rows[row_tasks == task]
        if place == "predictor":
            consumer = robot or next(iter(rows["consumer"]), "")
        elif place == "descriptor" and not after:
            consumer = SHARED
        else:
            consumer = after
            if after in ("", STRONGEST):
                strongest = self.strongest.get(task, Address())
                consumer = strongest.consumer
                rows = rows[rows["knowledge"] == strongest.adversary]
            consumer = replace(parse_consumer(consumer), task=task).consumer
        values = rows[rows["consumer"] == consumer]
        if values.empty:
            has = ", ".join(dict.fromkeys(rows["consumer"])) or "nobody in this task"
            raise SettingsError(
                f"the run has no {name} of {consumer or after!r}; it has that of {has}"
            )
        table = self._level_frame(values)
        table.attrs["title"] = (
            f"{METRICS[name].title}, {_positions_label(values, place)}"
        )
        return table

    def _level_frame(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Return rows of a summary with the columns that `frame` promises."""
        known = rows["mechanism"].map(self.families)
        is_attack = rows["knowledge"] != ""
        attack = [
            parse_consumer(consumer).attack_spec if is_so else ""
            for consumer, is_so in zip(rows["consumer"], is_attack, strict=True)
        ]
        columns = {
            "family": [family.name for family in known],
            "level": rows["level"].where(
                known.map(lambda family: family.is_added), 0.0
            ),
            "adding": [family.adding for family in known],
            "attack": attack,
        }
        columns |= {column: rows[column] for column in ("knowledge", *ENDS)}
        return pd.DataFrame(columns).reset_index(drop=True)

    def plot(
        self, *, x: str, y: str, task: str = "", robot: str = "", ax: Axes | None = None
    ) -> Axes:
        """Draw one metric over another, with 95 % intervals, and return the axes.

        `x` and `y` are metrics as in `frame`, or `plr_after`: after the strongest
        attack; `x` may be `level`, on a logarithmic axis, where raw is a line in its
        interval. A mechanism looks as on the page. `ax` are the axes to draw on, else
        new axes.
        """
        from matplotlib import (  # noqa: PLC0415 - slow to import, and seldom needed
            pyplot as plt,
        )

        from evaluation.reporting.charts import INKS, mechanism_looks  # noqa: PLC0415 - see `load`

        y_rows = self._scaled(y, task=task, robot=robot)
        if x == "level":
            x_rows = y_rows.assign(
                value=y_rows["level"], ci_low=math.nan, ci_high=math.nan
            )
            units = (f"{name} {unit}" for name, unit in LEVEL_UNITS.items())
            x_rows.attrs["title"] = "; ".join(["level", *units])
        else:
            x_rows = self._scaled(x, task=task, robot=robot)
        points = x_rows.merge(y_rows, on=_LEVEL_KEYS, suffixes=("_x", "_y"))
        if ax is None:
            ax = plt.subplots(figsize=(8.0, 4.5), layout="constrained")[1]
        if x == "level":
            ax.set_xscale("log")
        mechanisms = {
            (family.name, family.adding): family.mechanism
            for family in self.families.values()
        }
        looks = mechanism_looks(self.families.values())
        for (name, adding), rows in points.groupby(["family", "adding"], sort=False):
            ordered = rows.sort_values("level")
            mechanism = mechanisms[str(name), str(adding)]
            # Without a look of its own: clean.
            look = looks.get(mechanism, looks["raw"]._replace(hollow=True))
            ink = {"color": INKS[look.place], "label": f"{name} {adding}".rstrip()}
            if (
                x == "level" and not ordered["value_x"].to_numpy().any()
            ):  # raw has no level
                _draw_line(ax, ordered, look, ink)
            else:
                _draw_points(ax, ordered, look, ink)
        ax.set(xlabel=x_rows.attrs["title"], ylabel=y_rows.attrs["title"])
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
        return ax

    def _scaled(self, name: str, *, task: str = "", robot: str = "") -> pd.DataFrame:
        """Return a metric as it is shown, by a name that may end in `AFTER`."""
        metric = name.removesuffix(AFTER)
        after = STRONGEST if metric != name else ""
        rows = self.frame(metric, after=after, task=task, robot=robot)
        rows[ENDS] *= METRICS[SHORT.get(metric, metric)].scale
        return rows

    @property
    def dataset(self) -> str:
        """Name of the data set."""
        return str(self.manifest["dataset"]["name"])

    @property
    def n_reports(self) -> int:
        """Samples of a track's history, on average."""
        points: float = self.manifest["history"]["points"]
        return round(points)

    @cached_property
    def ours(self) -> pd.DataFrame:
        """The summary without the tasks that have a data set of their own."""
        rows = self.without_policy
        return rows[rows["dataset"] == self.dataset]

    @cached_property
    def families(self) -> dict[str, Family]:
        """The mechanisms of the run by name; the manifest knows which protect."""
        families = families_in(self.summary)
        for name, declared in entry_families(self.manifest.get("cells", ())).items():
            if name in families:
                families[name] = replace(families[name], protects=declared.protects)
        return families

    @cached_property
    def headline(self) -> Headline:
        """The numbers of the first table, for terminal, tables and page."""
        from evaluation.reporting.headline import headline  # noqa: PLC0415 - see `load`

        return headline(
            self.without_policy,
            attacks=self.strongest,
            linkability=self.linkability,
            attacked=self.attacked,
            epsilon_m=float(self.manifest["settings"]["stages"]["privacy.epsilon_m"]),
        )

    @cached_property
    def tasks(self) -> list[TaskOutcomes]:
        """The linkage tasks, on the run's data set or on their own."""
        from evaluation.estimates.linkability import task_outcomes  # noqa: PLC0415 - see `load`
        from evaluation.estimates.recordings import task_recording  # noqa: PLC0415 - see `load`

        expected = [
            task_recording(parse_consumer(consumer).task, dataset=self.dataset)
            for consumer in self.linkability["consumer"]
        ]
        return task_outcomes(self.linkability[self.linkability["dataset"] == expected])


def _positions_label(rows: pd.DataFrame, place: str) -> str:
    """Return which positions the rows of a consumer are about.

    `place` is the stage that measures their metric.
    """
    consumer, knowledge = str(rows["consumer"].iloc[0]), rows["knowledge"].unique()
    if consumer == SHARED:
        return "as shared"
    label = parse_consumer(consumer, knowledge[0] if len(knowledge) == 1 else "").label
    if place in ("descriptor", "reconstruction", "distance"):
        return f"after {label}"
    return label


def _draw_line(
    ax: Axes, rows: pd.DataFrame, look: Look, ink: Mapping[str, Any]
) -> None:
    """Draw a single value as a line across the axes, in the band of its interval."""
    values, ((below,), (above,)) = _error_bars(rows, "y")
    ax.axhline(values[0], linestyle="--" if look.hollow else ":", **ink)
    ax.axhspan(values[0] - below, values[0] + above, color=ink["color"], alpha=0.1)


def _draw_points(
    ax: Axes, rows: pd.DataFrame, look: Look, ink: Mapping[str, Any]
) -> None:
    """Draw the levels of a mechanism as a line of marks with their intervals."""
    from evaluation.reporting.charts import MARKERS  # noqa: PLC0415 - see `load`

    (x, x_error), (y, y_error) = _error_bars(rows, "x"), _error_bars(rows, "y")
    shape: dict[str, Any] = {
        "marker": MARKERS[look.shape],
        "capsize": 2,
        "linewidth": 0.8,
        "markerfacecolor": "none" if look.hollow else ink["color"],
    }
    ax.errorbar(x, y, y_error, x_error, **shape, **ink)


def _error_bars(rows: pd.DataFrame, side: str) -> tuple[Floats, Floats]:
    """Return values, (R,), and lengths of the bars below and above them, (2, R)."""
    values, low, high = (rows[f"{name}_{side}"].to_numpy() for name in ENDS)
    return values, np.maximum([values - low, high - values], 0.0)


def mechanism_columns(known: Mapping[str, Family]) -> list[Column]:
    """Return the columns mechanism, adding rule and level of a table."""

    def family(record: Mapping[str, Any]) -> Family:
        return find_family(known, record["mechanism"])

    return [
        text_column("mechanism", lambda record: family(record).name),
        text_column("adding", lambda record: family(record).adding),
        Column("level", lambda record: level_cell(record["level"])),
    ]


def estimates_by_level(
    frame: pd.DataFrame,
) -> dict[Where, dict[Address, dict[str, Estimate]]]:
    """Return the estimates of a summary by level, rising, then source, then metric."""
    by_level: dict[Where, dict[Address, dict[str, Estimate]]] = {}
    ordered = frame.sort_values("level", kind="stable", na_position="first")
    for key, estimate in estimates(ordered).items():
        by_source = by_level.setdefault(key.where, {})
        by_source.setdefault(key.source, {})[key.metric] = estimate
    place = {name: n for n, name in enumerate(frame["mechanism"].unique())}
    return dict(sorted(by_level.items(), key=lambda item: place[item[0][0]]))


def source_rows(frame: pd.DataFrame, source: Address) -> pd.DataFrame:
    """Return the rows of a summary about the positions of a source."""
    is_same = frame["knowledge"].fillna("") == source.adversary
    return frame[is_same & (frame["consumer"] == source.consumer)]


def representative_levels(
    wheres: Iterable[Where], known: Mapping[str, Family], *, controls: bool = True
) -> list[Where]:
    """Return the few levels that represent a run; all of them if it has none of these.

    Those are mechanisms without levels, the headline levels of FID and fixed noise,
    both ends of every other mechanism, and all levels of the controls if these are
    wanted.
    """
    levels: dict[str, list[float | None]] = {}
    for mechanism, level in wheres:
        levels.setdefault(mechanism, []).append(level)
    families = {mechanism: find_family(known, mechanism) for mechanism in levels}
    headline_names = {name for name, _ in HEADLINE}
    chosen: dict[str, list[float | None]] = {}
    for mechanism, own in levels.items():
        family = families[mechanism]
        if family.name in headline_names:
            chosen[mechanism] = [x for x in own if (family.name, x) in HEADLINE]
        elif family.family in CONTROLS:
            chosen[mechanism] = [x for x in own if controls or x is None]
        else:
            chosen[mechanism] = list(dict.fromkeys([own[0], own[-1]]))
    has_headline_level = any(
        set(chosen[name]) - {None}
        for name in chosen
        if families[name].name in headline_names
    )
    if not has_headline_level:
        chosen = levels
    # First mechanisms that add nothing; last those that declare no rule.
    rules = [*ADDING_RULES, ""]

    def rank(name: str) -> int:
        family = families[name]
        return 1 + rules.index(family.adding) if family.is_added else 0

    return [
        Where(name, level)
        for name in sorted(chosen, key=rank)
        for level in chosen[name]
    ]


@dataclass(frozen=True, eq=False, slots=True)
class Scheme:
    """A swept mechanism, and the axis of its level."""

    mechanism: str
    name: str  # Family and parameters, without the adding rule.
    # Adding rules under which it is shown: its own, or all if it declares none.
    rules: Sequence[str]
    title: str
    label: str  # Of the axis.
    log: bool
    place: int  # Of the name among all: it decides the look.

    @property
    def rule_text(self) -> str:
        """Its adding rule in words."""
        return f"{self.rules[0] if len(self.rules) == 1 else 'any'} adding"

    def describe_level(self, level: float) -> str:
        """Return a level with its symbol or unit."""
        return _LEVEL_PATTERNS.get(self.name, "{}").format(level_text(level))

    def select_rows(self, frame: pd.DataFrame) -> pd.DataFrame:
        """Return the rows of the levels that its axis can show, levels rising."""
        rows = frame[frame["mechanism"] == self.mechanism]
        rows = rows[rows["level"] > 0 if self.log else rows["level"].notna()]
        return rows.sort_values("level")


def schemes(summary: pd.DataFrame, *, as_points: bool = False) -> list[Scheme]:
    """Return the swept mechanisms of a run: every mechanism with levels but controls.

    A mechanism with too few levels for a curve, beside others with enough, is no sweep,
    unless it is FID or fixed noise: `as_points` includes it. FID and fixed noise come
    first, the others in the order of the run; the adding rules of a mechanism stand
    together.
    """
    by_mechanism = summary.dropna(subset="level").groupby("mechanism")
    levels = by_mechanism["level"].agg(["min", "max", "nunique"])
    swept = [
        family
        for family in families_in(summary).values()
        if family.mechanism in levels.index
        and family.is_added
        and family.family not in CONTROLS
    ]
    most = min(_LEAST_LEVELS, levels["nunique"].max()) if swept else 0
    if not as_points:
        enough = set(levels.index[levels["nunique"] >= most])
        swept = [
            family
            for family in swept
            if family.name in _PAPER_AXES or family.mechanism in enough
        ]
    names = list(dict.fromkeys([*_PAPER_AXES, *(family.name for family in swept)]))
    swept.sort(
        key=lambda family: (
            names.index(family.name),
            ADDING_RULES.index(family.rules[0]),
        )
    )
    swept_schemes = []
    for family in swept:
        own = levels.loc[
            [other.mechanism for other in swept if other.name == family.name]
        ]
        low, high = own["min"].min(), own["max"].max()
        title = FAMILY_NAMES.get(family.name, family.name)
        usual_axis = title, f"level of {title}", bool(0 < low <= high / _LOG_SPAN)
        title, label, is_log = _PAPER_AXES.get(family.name, usual_axis)
        swept_schemes.append(
            Scheme(
                mechanism=family.mechanism,
                name=family.name,
                rules=family.rules,
                title=title,
                label=label,
                log=is_log,
                place=names.index(family.name),
            )
        )
    return swept_schemes
