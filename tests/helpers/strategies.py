"""The profile under which hypothesis runs."""

from hypothesis import settings

# The same examples on every run: a failure is the code's, and mutants die or live for
# good.
reproducible = settings(
    derandomize=True, deadline=None, max_examples=100, database=None
)
