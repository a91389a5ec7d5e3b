"""Occupancy distributions of a hidden target."""
