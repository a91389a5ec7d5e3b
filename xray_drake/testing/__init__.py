"""A tiny heap and pytest fixtures, to test one system of a diagram."""
