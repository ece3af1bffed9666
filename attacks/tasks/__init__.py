"""Linkage tasks: windows of walks, their mates, and controls that must fail."""
