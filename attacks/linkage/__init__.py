"""Linkage attacks: find the tracks of one person in two releases. One file each."""
