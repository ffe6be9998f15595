"""Rotations of coefficients, the search for the best one, symmetries and a pose of its own for every shape."""
