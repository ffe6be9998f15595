"""Point clouds and meshes as spherical harmonics, in Open3D."""
