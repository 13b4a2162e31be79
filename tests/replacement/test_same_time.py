"""Scripts that keep their simulated time at another step: their counts, reporters, barostats, and what is refused."""

import io
from fractions import Fraction

import openmm
import pytest
from hypothesis import given
from hypothesis import strategies as some
from openmm import app, unit

import openmm_exactrb as rb
from openmm_exactrb.replacement.clock import SharedClock
from peptides import in_box
from places import CPU, REFERENCE
from starts import simulation_of

K, PS, FS = unit.kelvin, unit.picosecond, unit.femtosecond


def kept(interval, told=None):
    return rb.replace_integrators(interval, same_time=True, report=None if told is None else told.append)


def in_water(step, platform=REFERENCE):
    topology, system, x = rb.rigid_water(8)
    integrator = openmm.LangevinMiddleIntegrator(300 * K, 1 / PS, step)
    simulation = simulation_of(topology, system, integrator, x, platform=platform)
    simulation.context.setVelocitiesToTemperature(300, 1)
    return simulation


def time_of(simulation):
    return simulation.context.getTime().value_in_unit(FS)


def lines_of(every, interval=None, step=1 * FS, steps=120):
    """Return what a StateDataReporter writes of steps and times."""
    out = io.StringIO()

    def run():
        simulation = in_water(step)
        simulation.reporters.append(
            app.StateDataReporter(out, every, step=True, time=True, progress=True, totalSteps=steps)
        )
        simulation.step(steps)

    if interval is None:
        run()
    else:
        with kept(interval):
            run()
    return out.getvalue()


@pytest.mark.parametrize(
    ("every", "interval"), [(20, 4 * FS), (12, 6 * FS), (8, 2 * FS), (30, 1.5 * FS), (7, 0.5 * FS)]
)
def test_reports_show_the_steps_and_times_of_the_script(every, interval):
    ours, openmms = (text.splitlines() for text in (lines_of(every, interval), lines_of(every)))
    assert ours[0] == openmms[0]
    assert len(ours) == len(openmms) == 1 + 120 // every
    for one, other in zip(ours[1:], openmms[1:], strict=True):
        (done, step, time), (theirs, count, instant) = one.split(","), other.split(",")
        assert (done, step) == (theirs, count)
        assert float(time) == pytest.approx(float(instant), rel=1e-9)


@pytest.mark.parametrize("steps", [[40], [8, 32], [4] * 10, [24, 0, 16]])
def test_calls_divide_the_time_as_those_of_openmm(steps):
    with kept(4 * FS) as replaced:
        simulation = in_water(1 * FS)
        for n in steps:
            simulation.step(n)
        assert simulation.currentStep == 40
        assert simulation.integrator.getStepSize() == 1 * FS
        simulation.integrator.step(8)
        assert simulation.currentStep == 48
    assert simulation.context.getStepCount() == replaced.steps == 12
    assert time_of(simulation) == pytest.approx(48.0)
    assert replaced.gain == pytest.approx(4.0)


@pytest.mark.parametrize(
    "call", [lambda s: s.step(10), lambda s: s.integrator.step(2), lambda s: setattr(s, "currentStep", 3)]
)
def test_steps_that_cannot_be_divided_are_refused_before_any_is_made(call):
    with kept(4 * FS) as replaced:
        simulation = in_water(1 * FS)
        simulation.step(8)
        with pytest.raises(
            ValueError, match=r"cannot be divided, because 4 steps of 1 fs are 1 of 4 fs: .* multiple of 4"
        ):
            call(simulation)
        assert (simulation.currentStep, replaced.steps) == (8, 2)


class Every:
    """A reporter of a script, with an attribute that only it knows."""

    def __init__(self, steps):
        self.n, self.seen = steps, []

    def describeNextReport(self, simulation):
        return {"steps": self.n - simulation.currentStep % self.n, "include": []}

    def report(self, simulation, state):
        self.seen.append((simulation.currentStep, round(state.getTime().value_in_unit(FS), 6)))


def test_a_reporter_of_a_script_sees_its_own_counts():
    with kept(4 * FS):
        simulation = in_water(1 * FS)
        simulation.reporters.append(Every(12))
        simulation.step(36)
        assert simulation.reporters[0].seen == [(12, 12.0), (24, 24.0), (36, 36.0)]


def test_frames_of_a_trajectory_have_the_times_of_the_script(tmp_path):
    """Times in the header of a DCD file are the interval times the step."""
    headers = []
    for interval in (None, 4 * FS):
        file = tmp_path / f"{interval is None}.dcd"

        def run(file=file):
            simulation = in_water(2 * FS)
            simulation.reporters.append(app.DCDReporter(str(file), 20))
            simulation.step(40)
            del simulation.reporters[:]

        if interval is None:
            run()
        else:
            with kept(interval):
                run()
        headers.append(file.read_bytes()[:84])
    assert headers[0] == headers[1]


def test_a_step_that_the_script_changes_keeps_counts_and_times():
    """As after an equilibration with short steps."""
    with kept(4 * FS) as replaced:
        simulation = in_water(1 * FS)
        simulation.step(40)
        simulation.integrator.setStepSize(2 * FS)
        assert (simulation.currentStep, simulation.integrator.getStepSize()) == (40, 2 * FS)
        simulation.step(20)
        assert simulation.currentStep == 60
        simulation.currentStep = 0
        simulation.step(10)
        assert simulation.currentStep == 10
    assert time_of(simulation) == pytest.approx(100.0)
    assert replaced.gain == pytest.approx((40 + 30) / 25)


def test_a_loop_over_the_current_step_ends_where_the_script_means():
    with kept(4 * FS):
        simulation = in_water(2 * FS)
        while simulation.currentStep < 30:
            simulation.step(6)
    assert time_of(simulation) == pytest.approx(60.0)


def test_a_run_for_a_wall_time_goes_on_with_whole_steps():
    with kept(4 * FS):
        simulation = in_water(1 * FS)
        simulation.runForClockTime(0.2 * unit.second)
        count = simulation.currentStep
        assert count // 4 * 4 == pytest.approx(time_of(simulation))
        simulation.step(4 - count % 4 if count % 4 else 0)
        assert time_of(simulation) == pytest.approx(simulation.currentStep)


@pytest.mark.parametrize(
    ("every", "interval", "expected"), [(25, 4 * FS, 12), (100, 8 * FS, 25), (1, 4 * FS, 1), (0, 4 * FS, 0)]
)
def test_barostats_act_as_often_in_time_once_divided(every, interval, expected):
    told = []
    topology, system, x = in_box()
    system.addForce(openmm.MonteCarloBarostat(1 * unit.bar, 300 * K, every))
    with kept(interval, told):
        rb.heavy_hydrogens(system, topology)
        for _ in range(2):  # a System has Contexts one after the other
            integrator = openmm.LangevinMiddleIntegrator(300 * K, 1 / PS, 2 * FS)
            simulation = simulation_of(topology, system, integrator, x, platform=CPU)
            assert system.getForces()[-1].getFrequency() == expected
        simulation.minimizeEnergy(maxIterations=30)
        simulation.step(8)
    if every:
        assert (
            f"the MonteCarloBarostat acts every {expected} steps instead of every {every} steps of the script" in told
        )


def test_a_barostat_that_is_added_later_is_divided_too():
    """As OpenMM's cookbook adds it."""
    topology, system, x = in_box()
    with kept(4 * FS):
        integrator = openmm.LangevinMiddleIntegrator(300 * K, 1 / PS, 2 * FS)
        simulation = simulation_of(topology, system, integrator, x, platform=CPU)
        simulation.minimizeEnergy(maxIterations=30)
        simulation.step(4)
        for every, expected in ((50, 25), (20, 10)):
            system.addForce(openmm.MonteCarloBarostat(1 * unit.bar, 300 * K, every))
            simulation.context.reinitialize(preserveState=True)
            simulation.step(4)
            assert system.getForces()[-1].getFrequency() == expected
        assert simulation.currentStep == 12
    assert time_of(simulation) == pytest.approx(24.0)


@given(
    ratio=some.fractions(Fraction(1, 8), 8, max_denominator=8),
    parts=some.lists(some.integers(0, 60), min_size=1, max_size=8),
)
def test_parts_of_steps_amount_to_whole_steps(ratio, parts):
    """Whatever the parts are in which a Simulation asks for steps."""
    clock, made = SharedClock(0.001, 0.001 * float(ratio)), 0
    assert clock.ratio == ratio
    with clock.divided():
        for n, part in enumerate(parts, 1):
            made += clock.steps(part)
            assert made == sum(parts[:n]) // ratio
            assert clock.shown(made) == sum(parts[:n])
