"""Machines that the harvester's tests share."""

import pytest

from pickenv.harvester.machine import Machine, load_machine
from pickenv.harvester.true_machine import TrueMachine, load_true_machine


@pytest.fixture(scope="session")
def machine() -> Machine:
    return load_machine()


@pytest.fixture(scope="session")
def true(machine: Machine) -> TrueMachine:
    return load_true_machine(machine)
