"""Alignment of one shape onto another from any position."""
