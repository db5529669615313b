"""Films of comparisons, in which policies reach for the same fruit side by side."""
