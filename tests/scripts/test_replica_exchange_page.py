"""The scripts of the page on replica exchange run as they are printed, over the same alchemical states."""

import re
from pathlib import Path

import numpy as np
import openmm
import pytest
from openmm import unit

pytestmark = pytest.mark.filterwarnings("ignore")
reason = "pip install 'openmm-exactrb[validation]'"
alchemy = pytest.importorskip("openmmtools.alchemy", reason=reason)
cache = pytest.importorskip("openmmtools.cache", reason=reason)
mcmc = pytest.importorskip("openmmtools.mcmc", reason=reason)
from openmm_exactrb.openmmtools import ExactRigidBodyMove  # noqa: E402  # which needs openmmtools

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "how-to" / "replica-exchange.md"
PIECES = re.findall(r"^```py\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), flags=re.M | re.S)
(OPENFE,) = (piece for piece in PIECES if "openfe" in piece)


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    """Return what the script of the page defines and prints, and its folder."""
    folder, names, lines = tmp_path_factory.mktemp("page"), {"__name__": "__page__"}, []
    for name in ("methane.pdb", "methane.xml"):
        (folder / name).write_bytes((ROOT / "examples" / "data" / name).read_bytes())
    names["print"] = lines.append
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("OPENMM_DEFAULT_PLATFORM", "CPU")
        cache.global_context_cache.empty()
        cache.global_context_cache.set_platform(None)
        for piece in PIECES:
            if piece != OPENFE:
                exec(compile(piece, str(PAGE), "exec"), names)
    cache.global_context_cache.empty()
    return names, lines, folder


def test_the_script_samples_is_resumed_and_finds_free_energies(printed):
    names, lines, folder = printed
    assert names["sampler"].iteration == 10
    assert {type(move) for move in names["sampler"].mcmc_moves} == {ExactRigidBodyMove}
    log = np.loadtxt(folder / "exchange" / "log.csv", delimiter=",", skiprows=1, dtype=int)
    np.testing.assert_array_equal(log[:, 0], np.arange(1, 11))
    np.testing.assert_array_equal(log[:, 1], 50 + 25 * np.arange(1, 11))
    assert [line.split(":")[0] for line in lines] == ["openmmtools", "OpenMM"]
    values = [float(number) for line in lines for number in re.findall(r"-?\d+\.\d", line)]
    assert len(values) == 4
    assert np.isfinite(values).all()


def test_volumes_change_and_molecules_stay_rigid(printed):
    names, _, folder = printed
    replicas = names["sampler"].sampler_states
    stored = [(folder / "exchange" / f"checkpoint_{k}.xml").read_text(encoding="utf-8") for k in range(6)]
    states = [openmm.XmlSerializer.deserialize(text) for text in stored]
    volumes = [replica.volume / unit.nanometer**3 for replica in replicas]
    volumes += [state.getPeriodicBoxVolume()._value for state in states]
    assert len(set(volumes)) == 12
    system = names["plain"]
    constraints = [system.getConstraintParameters(k) for k in range(system.getNumConstraints())]
    i, j = np.array([constraint[:2] for constraint in constraints]).T
    lengths = np.array([constraint[2]._value for constraint in constraints])
    for x in [replica.positions / unit.nanometer for replica in replicas] + [
        state.getPositions(asNumpy=True)._value for state in states
    ]:
        np.testing.assert_allclose(np.linalg.norm(np.array(x)[i] - np.array(x)[j], axis=1), lengths, rtol=3e-6)


def test_both_samplers_have_the_same_states(printed):
    """The parameters that OpenMM's sampler sets are all that openmmtools changes, also with its exact PME."""
    names, _, _ = printed
    system = names["system"]
    contexts = [
        openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
        for _ in range(2)
    ]
    state, energies = alchemy.AlchemicalState.from_system(system), []
    for context in contexts:
        context.setPositions(names["modeller"].positions)
    for values in names["alchemical_states"]:
        for name, value in values.items():
            setattr(state, name, value)
            contexts[1].setParameter(name, value)
        state.apply_to_context(contexts[0])
        energies.append([context.getState(energy=True).getPotentialEnergy()._value for context in contexts])
    theirs, ours = np.array(energies).T
    np.testing.assert_allclose(ours, theirs, rtol=1e-12)
    assert len({f"{energy:.6f}" for energy in ours}) == 6


class UnitOfOpenFE:
    """What the page takes from OpenFE, which is not a requirement of the tests: a method that returns this move."""

    @staticmethod
    def _get_integrator(integrator_settings, simulation_settings, system):
        assert (simulation_settings, system) == ("simulation", "system")
        return mcmc.LangevinDynamicsMove(n_steps=300, n_restart_attempts=20, **integrator_settings)


def test_a_unit_of_openfe_has_the_move_with_the_settings_of_its_own():
    names = {"AHFESolventSimUnit": UnitOfOpenFE}
    exec(re.sub(r"^from openfe.*$", "", OPENFE, flags=re.M), names)
    settings = {"timestep": 8 * unit.femtosecond, "collision_rate": 2 / unit.picosecond, "reassign_velocities": True}
    move = names["RigidBodySolventUnit"]._get_integrator(  # noqa: SLF001
        integrator_settings=settings, simulation_settings="simulation", system="system"
    )
    assert type(move) is ExactRigidBodyMove
    assert {name: getattr(move, name) for name in settings} == settings
    assert (move.n_steps, move.n_restart_attempts, move.scheme) == (300, 20, "BAOA")
