"""Pictures of arms, fruit and trees: environments fill a `Stage`, and `painted` draws it."""
