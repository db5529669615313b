"""The plant, that is the simulated true arm: its files, random draws of arms, simulated measurements and tests."""
