"""Many rollouts, and what they say."""
