"""Radial functions of meshes and clouds: rays, the test for star-shaped surfaces, centres, robust fits."""
