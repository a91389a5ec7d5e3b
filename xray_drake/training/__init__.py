"""Training and evaluation of the occupancy networks; without Drake."""
