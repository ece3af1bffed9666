"""One unit of work's numbers: scenes, adversaries, reconstruction, linkage; no disk."""
