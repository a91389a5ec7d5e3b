"""Experiments behind the README's tables, each a :class:`.study.Study`."""
