"""Fields on concentric shells around a shape, and surfaces of fields in space."""
