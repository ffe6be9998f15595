"""Features of shapes that do not depend on pose, size or triangulation, and distances between them."""
