"""One module per algorithm, each with a dict `hyperparams` of parameters by environment id, as rl_zoo3 reads it."""
