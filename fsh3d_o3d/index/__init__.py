"""A library of shapes on disk or in object storage that answers which of them are most like another."""
