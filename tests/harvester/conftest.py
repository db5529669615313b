"""Machines that the harvester's tests share."""

import pytest

from pickenv.harvester import Machine, TrueMachine, load_machine, load_true_machine


@pytest.fixture(scope="session")
def machine() -> Machine:
    return load_machine()


@pytest.fixture(scope="session")
def true(machine: Machine) -> TrueMachine:
    return load_true_machine(machine)
