"""Geometry and bytes in files and in object storage: read without trusting them, written whole or not at all."""
