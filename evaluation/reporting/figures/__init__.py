"""The figures of a run, a file each."""
