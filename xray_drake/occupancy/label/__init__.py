"""The label: the distribution as who knows the true pose makes it."""
