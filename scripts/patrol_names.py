"""Names that the scripts of patrols share: files, recordings, mechanisms, robots."""

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
ROBOTS: Final = {"least_squares": "line robot", "kalman_cv": "Kalman robot"}
"""Predictors, and what tables call them."""
