"""What a run refuses: arguments, reporters, and Simulations of another run."""

import openmm
from openmm import app
from small_droplets import droplet, make

import openmm_exactrb as rb
from refusals import assert_refused, in_a_folder, refused
from starts import simulation_of


def other_settings(folder):
    run, simulation = make(folder), droplet()
    run.advance(simulation, 10)
    simulation.integrator.setStepSize(0.001)
    run.advance(simulation, 20)


def other_system(folder):
    run = make(folder)
    run.advance(droplet(), 10)
    run.advance(droplet(n=5), 20)


def other_columns(folder):
    for end, columns in ((10, {"potentialEnergy": True}), (10, {"potentialEnergy": True}), (20, {"temperature": True})):
        run = rb.Run(folder, resume=True)
        run.add_reporter(app.StateDataReporter, "log.csv", 5, step=True, **columns)
        run.advance(droplet(), end)


def file_named_system(folder):
    for n in (4, 5):
        run = rb.Run(folder, resume=True)
        run.add_reporter(rb.EnergyReporter, "System", 5)
        run.advance(droplet(n=n), 10 * (n - 3))


def with_reporter(folder, name, reporter=rb.EnergyReporter, interval=5, **options):
    make(folder).add_reporter(reporter, name, interval, **options)


def of_two_values(folder, make, values):
    """Go on with the run of an integrator of one value, and then with that of another."""
    for value in (values[0], *values):
        run = rb.Run(folder, resume=True)
        run.add_reporter(app.DCDReporter, "trajectory.dcd", 10)
        made = make(value)
        run.advance(made if isinstance(made, app.Simulation) else with_integrator(made), 20)


def with_integrator(integrator):
    topology, system, positions = rb.dipole_fluid(4, seed=1, trap=0.5)
    return simulation_of(topology, system, integrator, positions)


def own_scheme(weight):
    """Return a scheme whose name does not tell the weight of its outer drifts."""
    return rb.schemes.symmetric("mine", order=2, stages=2, first="drift", a=(weight,))


def with_momenta(temperature):
    simulation = with_integrator(rb.ExactRigidBodyIntegrator(0.005, scheme="V2"))
    simulation.reporters.append(rb.CanonicalMomenta(temperature, 5, 1))
    return simulation


@refused(
    (in_a_folder(other_settings), r"another run, in which integrator stepSize was 0\.005"),
    (in_a_folder(other_system), "another run, in which System was 20 particles"),
    (in_a_folder(other_columns), r"file log.csv was .*potentialEnergy.*temperature"),
    (in_a_folder(file_named_system), "another run, in which System was 20 particles"),
    *(
        (in_a_folder(with_reporter, *arguments), sentence)
        for arguments, sentence in [
            (("energies.csv",), "another reporter already writes the file energies.csv"),
            (("checkpoint",), "checkpoint is a file of the run itself"),
            (("topology.pdb",), "topology.pdb is a file of the run itself"),
            (("./checkpoint",), "checkpoint is a file of the run itself"),
            (("checkpoint.part",), "checkpoint.part is a file of the run itself"),
            (("a/../energies.csv",), "another reporter already writes the file energies.csv"),
            (("../energies.csv",), "energies.csv is outside the folder of the run"),
            (("/energies.csv",), "/energies.csv is outside the folder of the run"),
            (("other.dcd", "DCD"), "not 'DCD'"),
            (("other.csv", rb.EnergyReporter, 2**31), "interval must be below 2147483648 steps"),
        ]
    ),
    *(
        (in_a_folder(with_reporter, "other", reporter, **options), sentence)
        for reporter, options, sentence in [
            (app.StateDataReporter, {"densities": True}, r"StateDataReporter does not accept .*'densities'"),
            (rb.EnergyReporter, {"step": True}, r"EnergyReporter does not accept .*'step'"),
            (app.DCDReporter, {"append": True}, r"DCDReporter does not accept .*'append'"),
            (app.DCDReporter, {"reportInterval": 5}, r"DCDReporter does not accept .*'reportInterval'"),
            (app.PDBReporter, {"enforcePeriodicBox": False}, "PDBReporter cannot resume a file"),
        ]
    ),
    (in_a_folder(rb.Run, settings=5), "settings must be a mapping"),
    *((in_a_folder(rb.Run, every=every), "number of seconds") for every in (-1.0, float("nan"))),
    *(
        (
            in_a_folder(of_two_values, lambda value, make=make: with_integrator(make(value)), values),
            "another run, in which integrator",
        )
        for make, values in [
            (lambda T: openmm.LangevinMiddleIntegrator(T, 1.0, 0.005), (30, 60)),
            (lambda T: openmm.MTSLangevinIntegrator(T, 1.0, 0.005, [(0, 1)]), (30, 60)),
            (lambda w: rb.ExactRigidBodyIntegrator(0.005, scheme=own_scheme(w)), (0.19, 0.3)),
        ]
    ),
    (
        in_a_folder(of_two_values, with_momenta, (30.0, 60.0)),
        r"another run, in which CanonicalMomenta was 30\.0 K every 5 steps",
    ),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
