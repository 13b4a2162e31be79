"""Goes on from XML files in a process where the package cannot be imported: folder, platform, precision, steps."""

import sys
from pathlib import Path


class Refusing:
    """Refuses to find the package."""

    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == "openmm_exactrb":
            raise ImportError(f"{name} must not be imported here")


sys.meta_path.insert(0, Refusing())

import numpy as np  # noqa: E402
import openmm  # noqa: E402

folder, name, precision, steps = Path(sys.argv[1]), *sys.argv[2:5]
system, integrator, state = (
    openmm.XmlSerializer.deserialize((folder / f"{part}.xml").read_text()) for part in ("system", "integrator", "state")
)
properties = {"Precision": precision} if precision != "-" else {}
context = openmm.Context(system, integrator, openmm.Platform.getPlatform(name), properties)
context.setState(state)
integrator.step(int(steps))
state = context.getState(positions=True, velocities=True)
np.save(
    folder / "plain.npy",
    np.array([state.getPositions(asNumpy=True)._value, state.getVelocities(asNumpy=True)._value]),
)
assert "openmm_exactrb" not in sys.modules
