"""How well a descriptor retrieves: classifications, metrics of the Princeton benchmark, re-ranking by neighbours."""
