"""A run from settings to data frames and files: plan, execute, report.

`running` has `run`; `run_estimates` and `run_results` make the results from finished
cells; `stronger` attacks the levels that would be proposed; `study_runs` pools several
runs. `card_entries`, `card_maker`, `card_checks` and `board` are for cards.
"""

from evaluation.api.run_results import build, rebuild
from evaluation.api.running import run, sized
from evaluation.api.study_runs import study
from evaluation.reporting.finished import load
from evaluation.reporting.rows import Results

__all__ = ["Results", "build", "load", "rebuild", "run", "sized", "study"]
