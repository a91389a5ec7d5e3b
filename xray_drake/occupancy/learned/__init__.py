"""Networks that predict occupancy distributions: inputs, weights, inference."""
