"""Target detection and instance segmentation."""
