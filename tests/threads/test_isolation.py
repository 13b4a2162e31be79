"""Integrators, Contexts and threads of one process do not disturb each other, and nothing is left of them."""

import gc
import mmap
import sys
import threading
import weakref
from pathlib import Path

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
import starts
import three_masses
from benchmarks.paper import problems
from both_engines import apart, begun, maker
from few_dipoles import simulation_of, snapshot
from lifetimes import assert_freed_without_the_garbage_collector
from openmm_exactrb.mathematics import quaternions
from openmm_exactrb.multiple_time_steps.inner_drift import ExcerptPositions
from openmm_exactrb.openmm_access.find_context import find_context
from peptides import peptide
from starts import held
from zoo import water

KINDS = [("SRKN4_6b", "exact", 0.01), ("V2", "mclachlan_reich", 0.005), ("S2_4", "quaternion_a", 0.008)]


def dipoles(kind, seed):
    scheme, rotor, h = kind
    return simulation_of(4, h, scheme, rotor, seed=seed).context


def together(*tasks):
    """Run functions in threads that start at once, and raise what they raise."""
    barrier, errors = threading.Barrier(len(tasks)), []

    def run(task):
        barrier.wait()
        try:
            task()
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=run, args=(task,)) for task in tasks]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for error in errors:
        raise error


@pytest.fixture
def switching_often():
    """Let threads take turns a thousand times as often as usual."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(5e-6)
    yield
    sys.setswitchinterval(before)


def test_contexts_that_take_turns_or_run_in_threads_end_in_the_bits_of_runs_alone(switching_often):
    pairs = [(kind, seed) for kind in KINDS for seed in (1, 2)]
    alone = [dipoles(*pair) for pair in pairs]
    for context in alone:
        context.getIntegrator().step(20)
    by_turns, threaded = ([dipoles(*pair) for pair in pairs] for _ in range(2))
    for _ in range(4):
        for context in by_turns:
            context.getIntegrator().step(5)
    together(*(lambda c=context: [c.getIntegrator().step(5) for _ in range(4)] for context in threaded))
    for one, others in zip(alone, zip(by_turns, threaded, strict=True), strict=True):
        for other in others:
            np.testing.assert_array_equal(held(other), held(one))


def test_integrators_that_are_bound_in_threads_find_their_own_context(switching_often):
    contexts = [dipoles(KINDS[0], seed) for seed in range(6)]
    found = {}
    together(
        *(lambda k=k, c=context: found.update({k: c.getIntegrator().bodyState()}) for k, context in enumerate(contexts))
    )
    for k, context in enumerate(contexts):
        bodies, state = found[k]
        x = held(context)[0]
        np.testing.assert_allclose(bodies.positions(state, x.copy()), x, rtol=0.0, atol=1e-13)
        assert all(np.abs(x - held(other)[0]).max() > 0.1 for other in contexts if other is not context)


def test_a_search_for_the_context_breaks_no_tuple_that_another_thread_is_making(switching_often):
    """A tuple that something else refers to while it grows is a SystemError (_PyTuple_Resize)."""
    context, over = dipoles(KINDS[0], 1), threading.Event()

    def search():
        try:
            for _ in range(10):
                assert find_context(context.getIntegrator()) is context
        finally:
            over.set()

    def make_tuples():
        while not over.is_set():
            assert len(tuple(k for k in range(100))) == 100  # of a length that is not known beforehand

    together(search, make_tuples, make_tuples)


def test_contexts_in_threads_do_not_disturb_each_other(place):
    engine, platform = place
    alone, *others = (begun(*water(), maker("W2_1", 0.001)(engine), platform=platform) for _ in range(3))
    alone.getIntegrator().step(10)
    together(*(lambda c=context: c.getIntegrator().step(10) for context in others))
    assert [apart(alone, context) for context in others] == [0.0, 0.0]


@pytest.mark.parametrize("method", rb.ROTORS)
def test_one_flow_serves_several_threads(method, switching_often):
    top, start = problems.HeavyTop.random(np.random.default_rng(1), 0.1, 1.0, 20)
    flow = rb.rotors.rotor(method, top.inertia.T)

    def run(state):
        for _ in range(30):
            state = flow(*state, 0.05)
        return np.vstack(state)

    starts = [(start[0], sign * start[1]) for sign in (1.0, -1.0, 0.5)]
    expected, got = [run(state) for state in starts], {}
    together(*(lambda k=k: got.update({k: run(starts[k])}) for k in range(3)))
    for k, one in enumerate(expected):
        np.testing.assert_array_equal(got[k], one)


def megabytes():
    """Return the memory that the process holds now."""
    return int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1]) * mmap.PAGESIZE / 2**20


def context_of_a_three_masses():
    """Return a Context with an integrator that has made a step."""
    context = starts.context_of(three_masses.system(), rb.ExactRigidBodyIntegrator(0.01), three_masses.POSITIONS)
    context.getIntegrator().step(1)
    return context


def make_and_drop(n):
    """Make n integrators with a Context each and drop them; return weak references to them."""
    left = []
    for _ in range(n):
        context = context_of_a_three_masses()
        integrator = context.getIntegrator()
        left += [weakref.ref(integrator), weakref.ref(context), weakref.ref(integrator.bodyState()[0])]
    return left


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_hundreds_of_integrators_leave_nothing():
    make_and_drop(50)
    gc.collect()
    before = megabytes()
    left = make_and_drop(100)
    gc.collect()
    assert not any(reference() for reference in left)
    growth = megabytes() - before
    kept = [context_of_a_three_masses() for _ in range(50)]
    cost = (megabytes() - before - growth) / len(kept)
    assert growth < 0.2 * 100 * cost, f"{growth:.1f} MB stayed; a Context holds {cost:.3f} MB"


def nested_and_dropped():
    """Return weak references to a Context and an integrator with inner steps that were used and dropped."""
    _, system, x = peptide()
    integrator = rb.ExactRigidBodyIntegrator(0.002, "S2_2", fast="bonded", engine="host")
    context = starts.context_of(system, integrator, x)
    integrator.step(1)
    inner = [found for found in gc.get_objects() if isinstance(found, ExcerptPositions)]
    assert len(inner) == 1
    return [weakref.ref(integrator), weakref.ref(context), weakref.ref(inner[0])]


@pytest.mark.parametrize("dropped", [lambda: make_and_drop(3), nested_and_dropped])
def test_contexts_are_freed_without_the_garbage_collector(dropped):
    assert_freed_without_the_garbage_collector(dropped)


@pytest.mark.parametrize(
    ("t", "rotor", "apart"),
    [
        pytest.param(0.1, "exact", 0.0, marks=pytest.mark.library),
        (100.0, "exact", 1e-13),  # mostly by the closed form
        (0.1, "exact_numpy", 4e-15),
        (5.0, "exact_numpy", 4e-15),
    ],
)
def test_a_body_does_not_feel_the_others_of_its_array(rng, rotor, apart, t):
    n = 200
    inertia, q, m = rng.uniform(0.5, 2.0, (n, 3)), quaternions.random(rng, n), rng.standard_normal((n, 3))
    together = rb.free_rotor(inertia, q, m, t, rotor)
    for i in range(n):
        alone = rb.free_rotor(inertia[i : i + 1], q[i : i + 1], m[i : i + 1], t, rotor)
        for one, all_of_them in zip(alone, together, strict=True):
            np.testing.assert_allclose(one[0], all_of_them[i], rtol=0.0, atol=apart)


def test_integrators_and_threads_do_not_disturb_each_other():
    alone = simulation_of(4, h=0.01)
    alone.integrator.step(30)
    pair = [simulation_of(4, h=0.01) for _ in range(3)]
    pair[0].integrator.step(10)
    pair[1].integrator.step(30)
    pair[0].integrator.step(20)
    threads = [threading.Thread(target=pair[2].integrator.step, args=(30,))]
    other = simulation_of(h=0.03)
    threads.append(threading.Thread(target=other.integrator.step, args=(30,)))
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for simulation in pair:
        np.testing.assert_array_equal(snapshot(simulation)[0], snapshot(alone)[0])


@pytest.mark.parametrize("ask", [lambda integrator: integrator.step(1), lambda integrator: integrator.temperatures()])
def test_a_second_thread_is_refused_within_a_step_and_the_first_one_loses_nothing(ask):
    within, asked = threading.Event(), threading.Event()

    def slow(state):
        within.set()
        asked.wait(600.0)
        return 0.0, np.zeros((state.getPositions(asNumpy=True).shape[0], 3))

    simulation = simulation_of(2)
    simulation.system.addForce(openmm.PythonForce(slow))
    simulation.context.reinitialize(preserveState=True)
    thread = threading.Thread(target=simulation.integrator.step, args=(3,))
    thread.start()
    within.wait(600.0)
    with pytest.raises(RuntimeError, match=r"already performing a step, .* give each thread its own integrator"):
        ask(simulation.integrator)
    asked.set()
    thread.join()
    assert simulation.context.getStepCount() == 3
    simulation.integrator.step(1)
    assert simulation.context.getStepCount() == 4
