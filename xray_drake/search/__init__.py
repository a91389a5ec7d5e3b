"""The whole search: diagram, monitor, rollout, record."""
