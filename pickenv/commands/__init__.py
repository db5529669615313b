"""The commands of `pickenv.cli`, one file per subject; each command is a thin function over the library."""
