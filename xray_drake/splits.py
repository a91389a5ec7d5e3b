"""The parts that objects and images are divided into."""

SPLITS = ("train", "validation", "test")
"""No object is in two of them; of the procedural library, test has families
that training never uses."""
