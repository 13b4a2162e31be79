import pytest
from equilibrium import equilibrated

import openmm_exactrb as rb


@pytest.fixture(scope="session")
def droplet():
    """System and State of eight TIP3P molecules without cutoff."""
    _, system, positions = rb.rigid_water(8)
    return system, equilibrated(system, positions)
