"""The one way from rows to a result, and what is done with it."""
