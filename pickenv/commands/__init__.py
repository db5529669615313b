"""The commands of `pickenv.cli`, a file per room; each is a thin function over it."""
