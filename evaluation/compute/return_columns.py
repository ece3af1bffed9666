"""Rows and columns of the cells of people who come back, for their readers."""

from typing import Final

from evaluation.plan.address import control_name

CLEAN: Final = "clean"  # SPEC of the mechanism without any error.
STRONGEST: Final = control_name("strongest")
"""Row of the control that was chosen for each person on other people."""
SAME_SESSION: Final = control_name("same-run")
"""Row of the fusion within a session, where the queue identifies people: no result."""
RANK1, CHANCE, GAIN = "rank1", "chance", "rank1_gain"
NESTED_P: Final = "nested_p"
CHOSEN: Final = "chosen"  # Number of people for whom a control was chosen.
CONFIRMING_GAIN, CONFIRMING_P = "confirming_gain", "confirming_p"
COLUMNS: Final = ("row", "knowledge", "metric", "value", "ci_low", "ci_high", "n")
