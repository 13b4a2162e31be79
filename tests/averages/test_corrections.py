"""Corrections of the averages of runs, against exact averages and difference quotients."""

import contextlib
import json

import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
from openmm_exactrb.averages.frames import BAR
from openmm_exactrb.averages.record import read

KT = 0.00831446261815324 * 300.0
COUNT = 500


def rotors(integrator, strength=2.0):
    """Return a Simulation of linear rotors of the moment kT ps² in a field: V = -strength kT cos."""
    system, length, topology = openmm.System(), 0.2, app.Topology()
    force = openmm.CustomExternalForce("-pull*z")
    force.addPerParticleParameter("pull")
    chain = topology.addChain()
    for k in range(COUNT):
        residue = topology.addResidue("ROT", chain)
        for sign in (-1.0, 1.0):
            topology.addAtom("X", None, residue)
            index = system.addParticle(2.0 * KT / length**2)
            force.addParticle(index, [sign * strength * KT / length])
        system.addConstraint(2 * k, 2 * k + 1, length)
    system.addForce(force)
    simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
    x = np.zeros((COUNT, 2, 3))
    x[:, :, 0] = 3.0 * np.arange(COUNT)[:, None]
    x[:, 1, 2] = length
    simulation.context.setPositions(x.reshape(-1, 3))
    simulation.context.setVelocitiesToTemperature(300.0, 1)
    return simulation


def cosine(x):
    """Return the mean cosine to the field."""
    pairs = x.reshape(-1, 2, 3)
    return float((pairs[:, 1, 2] - pairs[:, 0, 2]).mean() / 0.2)


@pytest.mark.validate
def test_the_correction_of_rotors_in_a_field_leads_to_the_exact_average(tmp_path):
    """The average of Langevin is coth(a) - 1/a; the uncorrected one is more than six errors off.

    Rotors do not share their energy with their centres of mass, as the limit of weak friction assumes; with W2_3m the
    rest of the error that depends on friction is a thirtieth.
    """
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, 1.5, scheme="W2_3m", checkDivergence=False)
    integrator.setRandomNumberSeed(4)
    simulation = rotors(integrator)
    simulation.step(20)
    file = tmp_path / "averages.csv"
    with reporting(simulation, file, 1, observables={"cosine": cosine}):
        simulation.step(1500)
    exact = 1.0 / np.tanh(2.0) - 0.5
    values = read(file)[1]
    found, energy, by_hand = (
        rb.corrected(file, *of)
        for of in (("cosine",), ("potential energy",), (values["cosine"], values["cosine slope"]))
    )
    uncorrected = found.mean - found.correction
    assert abs(uncorrected - exact) > 6.0 * found.error
    # What is left is of fourth order, and what the limit of weak friction misses.
    assert abs(found.mean - exact) < 0.3 * abs(uncorrected - exact)
    assert found.correction_error < 0.15 * abs(found.correction)
    # The fourth-order error of harmonic motions is subtracted from the energy alone.
    fourth = read(file)[0].quartic * 1.5**4 * np.var(values["square"]) / (4.0 * KT)
    assert (energy.mean + fourth) / (-2.0 * KT * COUNT) == pytest.approx(found.mean, rel=1e-6)
    assert abs(energy.mean / (-2.0 * KT * COUNT) - exact) < abs(found.mean - exact)
    assert by_hand == found


@contextlib.contextmanager
def reporting(simulation, file, interval, **options):
    """Have a Simulation write averages, and close the file."""
    reporter = rb.AverageReporter(file, interval, **options)
    simulation.reporters.append(reporter)
    try:
        yield
    finally:
        reporter.close()
        simulation.reporters.remove(reporter)


SMOOTH = {"nonbondedMethod": app.PME, "nonbondedCutoff": 0.6, "switchDistance": 0.5, "ewaldErrorTolerance": 1e-6}


def water(integrator, *forces, model="tip3p"):
    topology, system, positions = rb.rigid_water(64, model=model, **SMOOTH)
    for force in forces:
        system.addForce(force)
    simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
    simulation.context.setPositions(positions)
    simulation.context.setVelocitiesToTemperature(300.0, 2)
    return simulation


def made(tmp_path, rng, frames=4000, barostat="MonteCarloBarostat", quartic=0.0):
    """Return the file of frames that are independent and normal, and its columns."""
    settings = {
        "scheme": "W2_3m", "step": 0.024, "alpha": 1e-3, "beta": 5e-3, "slopes": [8e-3, 1e-3],
        "barostat_slope": 6e-3, "quartic": quartic, "temperature": 300.0, "kT": KT, "frictions": [5.0],
        "freedom": 384, "mass": 1153.0, "barostat": barostat, "pressure": 1.0, "observables": [],
    }  # fmt: skip
    volume, energy, square = 2.0 + 0.02 * rng.standard_normal(frames), *(rng.standard_normal((2, frames)))
    columns = {
        "step": np.arange(frames),
        "time": np.arange(frames),
        "potential": -2500.0 + 40.0 * energy - 300.0 * (volume - 2.0),
        "volume": volume,
        "square": 2e6 + 1e5 * (0.6 * energy + 0.8 * square) - 2e6 * (volume - 2.0),
        "inner square": np.zeros(frames),
        "work": 2e6 + 1e5 * (0.6 * energy + 0.8 * square) - 2e6 * (volume - 2.0),
        "inner work": np.zeros(frames),
        "damped work": np.full(frames, 2e6),
        "pressure": 500.0 * square - 2e4 * (volume - 2.0),
        "pressure slope": np.full(frames, 1e7),
        "pressure inner slope": np.zeros(frames),
    }
    file = tmp_path / "made.csv"
    rows = "\n".join(",".join(map(repr, map(float, row))) for row in zip(*columns.values(), strict=True))
    file.write_text(f"# {json.dumps(settings)}\n{','.join(columns)}\n{rows}\n")
    return file


def test_at_constant_pressure_averages_follow_the_pressure_at_a_fixed_volume(tmp_path):
    """By the means of the normal distribution: the volume moves by Var(V) dP/kT, and the energy with it."""
    file = made(tmp_path, np.random.default_rng(5))
    h2 = 0.024**2
    fixed = 500.0 * 0.8e5  # Cov(P, S) at a fixed volume
    # Friction adds nothing, as P and U are independent, or -2 alpha <slope> - alpha Cov(P, W)/kT: the middle.
    offset = h2 * (-6.5e-3 * fixed / KT - 7e-3 * 1e7)
    volume = rb.corrected(file, "volume")
    assert -volume.correction == pytest.approx(0.02**2 * offset / (KT * BAR), rel=0.1)
    square = 40.0 * 0.6e5  # Cov(U, S) at a fixed volume
    weak, strong = 2e-3 * 2e6 * 40.0**2 / (384 * KT**2), 2e-3 * 2e6 - 1e-3 * square / KT
    own = h2 * (-6e-3 * square / KT + 8e-3 * 2e6 + 0.5 * (weak + strong))
    energy = rb.corrected(file, "potential energy")
    assert -energy.correction == pytest.approx(own - 300.0 * 0.02**2 * offset / (KT * BAR), rel=0.05)
    found = rb.pressure_offset(file)
    assert found.bar == pytest.approx(offset, rel=0.05)
    assert found.bracket == pytest.approx(
        [h2 * (-6e-3 * fixed / KT - 6e-3 * 1e7), h2 * (-7e-3 * fixed / KT - 8e-3 * 1e7)], rel=0.05
    )
    # A barostat that has the offset needs the correction at a fixed volume only.
    without = 1.0 - found.bar
    assert rb.corrected(file, "volume", pressure=without).correction == pytest.approx(0.0, abs=1e-12)
    assert -rb.corrected(file, "potential energy", pressure=without).correction == pytest.approx(own, rel=0.05)
    # The fourth-order error of harmonic motions, from the fluctuations of S at a fixed volume.
    again = rb.corrected(made(tmp_path, np.random.default_rng(5), quartic=3e-3), "potential energy")
    fourth = 3e-3 * h2**2 * 1e10 / (4.0 * KT)
    assert energy.mean - again.mean == pytest.approx(fourth, rel=0.05)
    assert energy.systematic_error == pytest.approx(np.ptp(energy.bracket) / 12.0**0.5)
    assert again.systematic_error**2 - energy.systematic_error**2 == pytest.approx(fourth**2 / 12.0, rel=0.1)
    for average in (energy, again):
        assert 0.0 < average.systematic_error < min(average.error, average.correction_error)
    less = rb.corrected(file, "volume", pressure=101.0 * unit.bar).mean - volume.mean
    assert less == pytest.approx(-(0.02**2) * 100.0 / (KT * BAR), rel=0.1)
    assert rb.corrected(file, "compressibility").mean == pytest.approx(0.02**2 / (2.0 * KT * BAR), rel=0.1)
    # Fluctuations of the enthalpy, whose part from the volume is (P - 300 kJ/mol/nm³) V.
    along = 1.0 / BAR - 300.0
    for name, exact in (
        ("thermal expansion", along * 0.02**2 / (2.0 * KT * 300.0)),
        ("heat capacity", (40.0**2 + (along * 0.02) ** 2) / (KT * 300.0) + 192.0 * KT / 300.0),
    ):
        found = rb.corrected(file, name)
        assert found.mean - found.correction == pytest.approx(exact, abs=4.0 * found.error)
    values = read(file)[1]
    off = values["potential"] + values["volume"] / BAR
    off -= off.mean()
    by_hand = rb.corrected(file, off**2 / (KT * 300.0), -2.0 * off * values["work"] / (KT * 300.0))
    assert rb.corrected(file, "heat capacity").correction == pytest.approx(by_hand.correction, rel=1e-6)
    density = rb.corrected(file, "density")
    assert density.correction / density.mean == pytest.approx(-volume.correction / volume.mean, rel=1e-2)


def test_errors_are_those_of_independent_frames(tmp_path):
    """The jackknife's error of the mean of normal numbers, over several files."""
    rng, errors = np.random.default_rng(6), []
    for _ in range(6):
        file = made(tmp_path, rng, frames=500, barostat="")
        errors.append(rb.corrected(file, rng.standard_normal(500)).error)
    assert np.mean(errors) == pytest.approx(1.0 / np.sqrt(500), rel=0.25)


def test_a_run_continues_its_file_and_no_other(tmp_path):
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.002, scheme="BAOA")
    file, simulation = tmp_path / "water.csv", water(integrator)
    for append in (False, True):
        with reporting(simulation, file, 2, append=append):
            simulation.step(4)
    assert read(file)[1]["step"].tolist() == [2, 4, 6, 8]
    integrator.setStepSize(0.001)
    with (
        reporting(simulation, file, 2, append=True),
        pytest.raises(ValueError, match="other settings: pass another file to the AverageReporter"),
    ):
        simulation.step(2)
    simulation.reporters.clear()
    integrator.setStepSize(0.002)
    with reporting(simulation, file, 2, append=True):
        simulation.step(2)
        integrator.setFriction(2.0)
        with pytest.raises(ValueError, match="use a new AverageReporter with another file"):
            simulation.step(2)
    with file.open("a") as out:
        out.write("10,0.02")
    with pytest.raises(ValueError, match=r"line 8 of .* is incomplete: delete this line"):
        rb.corrected(file, "potential energy")


def test_what_a_file_lacks_is_said(tmp_path):
    file = made(tmp_path, np.random.default_rng(7), frames=100, barostat="")
    with pytest.raises(ValueError, match="'potental' is unknown: choose one of potential energy, pressure"):
        rb.corrected(file, "potental")
    with pytest.raises(
        ValueError, match="density can be corrected only for a run at constant pressure: add a MonteCarloBarostat"
    ):
        rb.corrected(file, "density")
    with pytest.raises(ValueError, match="for each of the 100 frames"):
        rb.corrected(file, np.zeros(99))
    for values, slope in ((np.full(100, np.nan), None), (np.zeros(100), np.zeros(99)), (np.zeros(100), np.inf)):
        with pytest.raises(ValueError, match="one finite number for each of the 100 frames"):
            rb.corrected(file, values, slope)
    with pytest.raises(ValueError, match=r"AverageReporter\(\.\.\., around=\(particles, distance\)\)"):
        rb.corrected(file, np.zeros(100), local=True)
    with pytest.raises(ValueError, match="the pressure, a property of the whole System: omit local="):
        rb.corrected(file, "pressure", local=True)
    with pytest.raises(ValueError, match="named observable, here 'pressure': omit slope="):
        rb.corrected(file, "pressure", np.zeros(100))
    with pytest.raises(ValueError, match="at constant volume, whose averages cannot be corrected to a pressure"):
        rb.corrected(file, "pressure", pressure=1.0)
    few = tmp_path / "few.csv"
    few.write_text("".join(file.read_text(encoding="utf-8").splitlines(keepends=True)[:20]))
    with pytest.raises(ValueError, match=r"at least 40 frames, but the number of frames in .* is 18: extend the run"):
        rb.corrected(few, "pressure")
    lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
    for wrong in ("nan", "inf", "x"):
        last = lines[-1].replace("2000000.0", wrong)
        assert last != lines[-1]
        few.write_text("".join([*lines[:-1], last]))
        with pytest.raises(ValueError, match=r"line 102 of .* contains a non-finite value"):
            rb.corrected(few, "pressure")
    few.write_text("".join([lines[0].replace('"barostat_slope"', '"others"'), *lines[1:]]))
    with pytest.raises(
        ValueError, match="written by another version of openmm_exactrb: read the file with that version"
    ):
        rb.corrected(few, "pressure")
    for text in ("step,time\n", "# header of another file\n1,2\n", "# [1, 2]\n1,2\n"):
        (tmp_path / "no.csv").write_text(text)
        with pytest.raises(ValueError, match="was not written by an AverageReporter"):
            rb.corrected(tmp_path / "no.csv", "pressure")


def test_an_offset_makes_a_barostat(tmp_path):
    offset = rb.pressure_offset(made(tmp_path, np.random.default_rng(8), frames=400, barostat=""))
    barostat = offset.barostat(1.0 * unit.atmosphere, 10)
    assert barostat.getDefaultPressure().value_in_unit(unit.bar) == pytest.approx(1.01325 + offset.bar)
    assert barostat.getDefaultTemperature()._value == pytest.approx(300.0)
    assert barostat.getFrequency() == 10
