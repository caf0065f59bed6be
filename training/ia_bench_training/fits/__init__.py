"""Fits of procedural scenes, from which the refiner learns what fits get wrong."""
