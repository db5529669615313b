"""One module per algorithm, each with a dict `hyperparams` by environment id, as rl_zoo3 reads its configurations."""
