"""Objects, bin, cameras, and heaps dropped until they rest."""
