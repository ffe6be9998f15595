"""Meshes and clouds as arrays, Open3D in and out, and what can be computed of triangles and points."""
