"""Geometry in and out: files, Open3D objects, radial sampling, sphere triangulation, error measures."""
