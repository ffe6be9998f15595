"""Shapes as immutable values: coefficients and what is needed to come back."""
