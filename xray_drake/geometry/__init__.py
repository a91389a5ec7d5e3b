"""Cameras, convex pieces and silhouettes, without Drake."""
