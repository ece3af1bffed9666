"""The run folder: its files, its manifest, and how they are written and checked."""
