"""The run folder, and who computes what is missing in it."""
