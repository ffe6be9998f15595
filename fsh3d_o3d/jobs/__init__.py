"""The same work for many files: worker processes that may die, Ray, and a cache of descriptors."""
