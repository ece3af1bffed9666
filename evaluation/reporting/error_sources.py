"""What every number rests on: the list of the page of a run, and of the documentation.

`docs/explanation/sources-of-error.md` has the same rows, and what to do about each.
"""

from dataclasses import dataclass
from typing import Final

DOCS_PAGE: Final = "sources-of-error.md"
"""Name of the page of the documentation, in `docs/explanation`."""


@dataclass(frozen=True, slots=True)
class ErrorSource:
    """An assumption of every run, and which way it may be wrong."""

    name: str
    assumption: str
    error: str  # Which way it errs; empty if it does not.


ERROR_SOURCES: Final = (
    ErrorSource(
        "association",
        "the network knows which detection belongs to which person",
        "robot and adversary look better than with a real tracker",
    ),
    ErrorSource(
        "reactions",
        "people do not give way to a robot",
        "conflicts are more frequent than they would be",
    ),
    ErrorSource(
        "sensing constants",
        "three constants are fitted to the paper's numbers",
        "by how much is unknown; they move all mechanisms in the same way",
    ),
    ErrorSource(
        "error law",
        "errors have the law that sensing.law names; the paper's are radial",
        "an adversary that knows a radial law gains from it",
    ),
    ErrorSource(
        "error shape",
        "the raw error has the same variance on both axes",
        "at the same mean square an ellipse raises attacked PLR by up to 5 points",
    ),
    ErrorSource(
        "adding rule",
        "linear noise enlarges the true error, which no real network can do",
        "PLR is the same; missed conflicts are not",
    ),
    ErrorSource(
        "the crowd",
        "plaza is simulated",
        "its people differ from recorded people",
    ),
    ErrorSource(
        "selection",
        "only tracks of at least resample.min_duration_s are used",
        "those people are slower than the others",
    ),
    ErrorSource(
        "overlap",
        "a track is used in many scenes; groups walk together",
        "",
    ),
    ErrorSource(
        "annotation",
        "recordings clicked at 2.5 or 1.25 Hz hold no gait",
        "linkage of clean data is too low",
    ),
    ErrorSource(
        "attacks",
        "the strongest built-in attack is not the strongest that there is",
        "leaks are too low: a limit holds as far as these attacks go",
    ),
    ErrorSource(
        "choice of an attack",
        "it is chosen on one half of the people and scored on the other",
        "",
    ),
    ErrorSource(
        "few people",
        "below 20 effective clusters nothing is decided",
        "",
    ),
)
