"""Grids, weights, harmonics, transforms and coefficients on the sphere; no Open3D here."""
