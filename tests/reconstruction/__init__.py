"""Tests of the choice of a method."""
