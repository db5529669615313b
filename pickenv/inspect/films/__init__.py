"""Films of comparisons: two policies side by side at the same fruit."""
