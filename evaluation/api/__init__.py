"""A run from settings to data frames and files: plan, execute, report.

`running` has `run`; `estimated` and `rebuilding` make the results from finished cells;
`stronger` attacks the levels that would be proposed; `studying` pools several runs.
"""

from evaluation.api.rebuilding import build, rebuild
from evaluation.api.running import run, sized
from evaluation.api.studying import study
from evaluation.reporting.finished import load
from evaluation.reporting.rows import Results

__all__ = ["Results", "build", "load", "rebuild", "run", "sized", "study"]
