"""The environment PickScene: fruit that hangs from a branch, with contact and cameras, in MuJoCo."""
