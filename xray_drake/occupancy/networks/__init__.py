"""Networks that predict occupancy distributions, and their weights."""
