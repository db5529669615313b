"""The Pick scene: fruit that hangs from a branch, touched and seen, in MuJoCo."""
