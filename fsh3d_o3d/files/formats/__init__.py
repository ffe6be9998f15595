"""One file a format: bytes into meshes and clouds, in Python and NumPy alone."""
