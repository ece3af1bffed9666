"""THE table of metrics, which everything that lists metrics or descriptors reads.

A new metric is a row here, and the function that computes it.
"""

from dataclasses import dataclass
from typing import Final, Literal

Measured = Literal[
    "predictor", "descriptor", "reconstruction", "distance", "linkage", "bound"
]
"""Of what a metric is: a predictor's utility; a privacy descriptor of positions, as shared and
after a reconstruction; what else a reconstruction is measured by; how far off positions
are beyond epsilon; what a linker achieves; what no attack does better in a world of the
fitted motion."""


@dataclass(frozen=True, slots=True)
class Metric:
    """A number of a run: what it is, and how it is shown."""

    name: str  # As in `summary.csv`.
    head: str  # Over a column: the field's own name, short.
    measured: Measured
    summary_unit: str = "fraction"  # As in `summary.csv`: a value is in this unit.
    noun: str = ""  # In a sentence; empty: as over a column.
    digits: int = 1  # Shown after the point, in the unit shown.
    # Of a cell's tracks: the metric is the mean of it, over those that have one.
    column: str = ""
    # What the sum of `column` is divided by, instead of the number of tracks.
    over: str = ""
    is_root: bool = False  # Whether the square root of that ratio is the metric.
    # Tested with the few that tell the story where runs are compared.
    is_headline: bool = False
    # Whether its replicates are, so that its intervals are basic ones.
    is_biased: bool = False
    is_difference: bool = False  # Of two metrics: it may be negative.

    @property
    def is_share(self) -> bool:
        """Whether it is a share of trials, 0..1."""
        return self.summary_unit == "fraction" and not self.is_difference

    @property
    def unit(self) -> str:
        """Unit shown; empty for a ratio."""
        return {"fraction": "%", "ratio": ""}.get(self.summary_unit, self.summary_unit)

    @property
    def scale(self) -> float:
        """What a value is multiplied with to be shown."""
        return 100.0 if self.summary_unit == "fraction" else 1.0

    @property
    def title(self) -> str:
        """Heading with the unit in brackets."""
        return f"{self.head} ({self.unit})" if self.unit else self.head

    @property
    def text(self) -> str:
        """In a sentence."""
        return self.noun or self.head


_ROWS: Final = (
    Metric(
        "missed_conflict_rate",
        "missed",
        "predictor",
        noun="missed-conflict rate",
        is_headline=True,
    ),
    Metric(
        "missed_future_rate", "missed future", "predictor", noun="missed-future rate"
    ),
    Metric(
        "false_alarm_rate",
        "false alarm",
        "predictor",
        noun="false-alarm rate",
        is_headline=True,
    ),
    Metric("distance_mae", "distance MAE", "predictor", "m", digits=2),
    Metric("plr_robot", "robot's own PLR", "predictor"),
    Metric("plr", "PLR", "descriptor", column="plr", is_headline=True),
    Metric("ael", "AEL", "descriptor", "s", digits=3, column="ael_s", is_headline=True),
    Metric("mel", "MEL", "descriptor", "s", digits=3, column="mel_s", is_headline=True),
    Metric("plr_worst_tenth", "PLR, worst tenth", "reconstruction"),
    Metric(
        "rmse", "RMSE", "reconstruction", "m", digits=3, column="mse_m2", is_root=True
    ),
    Metric(
        "rmse_over_benchmark",
        "RMSE ratio",
        "reconstruction",
        "ratio",
        digits=2,
        column="mse_m2",
        over="benchmark_mse_m2",
        is_root=True,
    ),
    Metric(
        "plr_over_benchmark",
        "PLR ratio",
        "reconstruction",
        "ratio",
        digits=2,
        column="plr",
        over="benchmark_plr",
    ),
    Metric("plr_wide", "PLR at 4/3 epsilon", "distance", column="plr_wide"),
    Metric(
        "median_error",
        "median error",
        "distance",
        "m",
        digits=2,
        column="median_error_m",
    ),
    Metric(
        "plr_gap", "below the optimum", "bound", column="plr_gap", is_difference=True
    ),
    Metric("rank1_optimum", "optimal rank 1", "bound"),
    Metric("rank1_gap", "below the optimum", "bound", is_difference=True),
    Metric("plr_optimum", "optimal PLR", "bound", column="plr_optimum"),
    Metric("plr_ceiling", "PLR ceiling", "bound", column="plr_ceiling"),
    Metric("rank1", "rank 1", "linkage", is_headline=True),
    Metric("rank1_g100", "rank 1 of 100", "linkage", is_headline=True),
    Metric("rank1_assigned", "rank 1, assigned", "linkage"),
    Metric("false_link_rate", "false links", "linkage"),
    Metric("mrr", "MRR", "linkage", "ratio", digits=3),
    Metric("auc", "AUC", "linkage"),
    Metric("eer", "EER", "linkage", is_biased=True),
    Metric("tpr_at_fpr_1pct", "TPR at FPR 1 %", "linkage"),
    Metric("tpr_at_fpr_01pct", "TPR at FPR 0.1 %", "linkage"),
    Metric("cllr", "Cllr", "linkage", "bit", digits=3),
    Metric("cllr_min", "Cllr_min", "linkage", "bit", digits=3, is_biased=True),
    Metric("d_sys", "D_sys", "linkage", "ratio", digits=3),
    Metric("d_sys_published", "D_sys, published program", "linkage", "ratio", digits=3),
    Metric("d_sys_corrected", "D_sys, corrected", "linkage", "ratio", digits=3),
    Metric("residual_risk", "residual risk", "linkage"),
    Metric("chance", "chance", "linkage"),
)
METRICS: Final = {
    metric.name: metric for metric in _ROWS
}  # In the order in which they are shown.


def measured(*where: Measured) -> tuple[str, ...]:
    """Return the names of the metrics that are measured there, in the order shown."""
    return tuple(metric.name for metric in _ROWS if metric.measured in where)


UTILITY: Final = measured("predictor")
DESCRIPTORS: Final = measured("descriptor")  # Of privacy: PLR, AEL and MEL.
RECONSTRUCTION: Final = measured(
    "descriptor", "reconstruction"
)  # Of what an attack rebuilds.
DISTANCE: Final = measured("distance")  # Whether errors lie just outside epsilon.
WIDE, MEDIAN = DISTANCE
GAP: Final = "plr_gap"  # In model worlds alone.
RANK_OPTIMUM, RANK_GAP = "rank1_optimum", "rank1_gap"  # The same of rank 1.
CEILING: Final = "plr_ceiling"
BOUNDS: Final = (
    "plr_optimum",
    CEILING,
)  # Of PLR after any attack, the exact one first.
MISSED_RATE: Final = "missed_conflict_rate"  # What noise costs a robot.
MISSED_FUTURE: Final = "missed_future_rate"
"""The same of conflicts that are still to come: nobody is inside the safety radius at step 0."""
EQUAL_ALARMS: Final = "missed_at_equal_false_alarms"
"""Missed conflicts at the false-alarm rate that the predictor has at raw; not in the summary."""
FUTURE_EQUAL_ALARMS: Final = "missed_future_at_equal_false_alarms"
"""Missed conflicts that are still to come, at that same rate; not in the summary."""
COSTS: Final = (
    MISSED_RATE,
    MISSED_FUTURE,
    EQUAL_ALARMS,
    FUTURE_EQUAL_ALARMS,
)  # Of noise.
FALSE_ALARMS: Final = "false_alarm_rate"
ERROR: Final = "distance_mae"  # How far off the separation is that a robot foresees.
OF_ROBOT: Final = "plr_robot"  # What a robot itself knows of where somebody was.
ROBOTS_OWN: Final = (ERROR, OF_ROBOT)  # What is told of a robot at a price.
WORST_TENTH: Final = "plr_worst_tenth"  # PLR of the most exposed tenth of the people.
EXPOSURE: Final = "plr"  # The descriptor that reconstructions are ranked by.
SUCCESS: Final = "rank1"  # What linkers are ranked by.
ASSIGNED: Final = "rank1_assigned"  # The same where all probes are matched at once.
# The same in a gallery of 100: what compares over runs.
SUCCESS_OF_100: Final = "rank1_g100"
LINKAGE_SHARE: Final = "linkage_share"
"""Rank 1 less chance as a share of what it is under raw, paired; in `levels.csv` alone."""
ACHIEVED: Final = (SUCCESS, "auc")  # What is compared of a linker at equal cost.
