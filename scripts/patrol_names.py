"""Names that the scripts of patrols share: files, recordings, policies, mechanisms."""

from typing import Final

NUMBERS: Final = "need-to-know.csv"
MATCHED: Final = "need-to-know-matched.csv"
RECORDINGS: Final = {
    "students03": "Students03",
    "zara01": "Zara01",
    "gc": "Grand Central, first 300 s",
    "plaza": "plaza, first 300 s",
}
MECHANISMS: Final = ("raw", "fid:1", "fixed:0.7,adding=independent", "ou:0.4")
POLICIES: Final = (
    "everything",
    "window:1.3",
    "window:4",
    "near:4.5",
    "near:3.5",
    "ahead:2",
    "ahead:1.2",
    "ahead:2,window_s=4,horizon_s=4.1",
    "state",
    "state:2",
    "flag",
    "random:0.2",
)
ROBOTS: Final = {"least_squares": "line robot", "kalman_cv": "Kalman robot"}
"""Predictors, and what tables call them."""
