"""The policies that the comparison of policies has: its example, and its scripts."""

from typing import Final

COMPARED_POLICIES: Final = (
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
"""Specs of policies, in the order of the tables."""
