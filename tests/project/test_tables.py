"""Figures of the pages follow from the records of benchmarks, in benchmarks/records."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

import openmm_exactrb as rb
from benchmarks import tables, write_tables
from benchmarks.common.markdown import with_error
from benchmarks.cost.tables import alchemical_systems, more_for_a_call
from benchmarks.dipoles.tables import dipole_memory, droplet_gains, largest_error
from benchmarks.water.tables import costs_of_settings, reading_points

ROOT = Path(__file__).resolve().parents[2]
#: Records of runs that the README and the pages of recommendations quote.
QUOTED = [
    *("default_energies", "dipole_droplet", "equipartition", "force_settings", "long_step_heating", "one_line"),
    *("outputs", "protein", "protein_steps", "reading_point", "reciprocal", "rigid_domains", "small_systems"),
    *("water_boxes", "water_boxes_loose", "water_densities"),
]


def test_figures_that_are_typed_are_those_that_were_measured():
    """Pages that are also read as plain Markdown have no substitutions."""
    pages = "README.md", "docs/index.md", "docs/which.md", "docs/appendix/joss.md"
    readme, index, which, joss = map(page, pages)
    figures = tables.figures()
    gain = f"{figures['W4_4_gain']} ± {figures['W4_4_gain_error']}"
    over_mts = f"{figures['protein_gain_over_mts']} times less energy error than `MTSIntegrator`"
    assert f"{over_mts}, and" in which
    assert f"{figures['protein_gain']} times less energy error than `VerletIntegrator(4 fs)` over 2 ps" in which
    assert f"{figures['protein_time']} of the time of `LangevinMiddleIntegrator(4 fs)`" in which
    assert f"energy errors of `W2_1` and `W4_4` are {1.0 / tables.over_verlet('W2_1'):.1f} and {gain} times" in joss
    assert f"at {figures['protein_throughput']} times the throughput of `LangevinMiddleIntegrator` at 4 fs" in joss
    for text in (readme, index):
        assert f"a protein runs {figures['protein_throughput']} times as fast as with OpenMM at 4 fs on a" in text
    assert f"and {figures['protein_throughput']} times as fast as OpenMM" in page("docs/tutorials/protein-8fs.md")
    assert f"{gain} times less energy error over 30 ps" in which
    assert f"with {figures['default_over_verlet']} of Verlet's energy error" in which
    more = f"with {25.0 * tables.asked('W4_4') - 100.0:.0f} % more force evaluations than `VerletIntegrator`"
    assert more in page("docs/tutorials/first-water.md")


@pytest.mark.parametrize("name", QUOTED)
def test_rows_of_records_that_are_quoted_name_engine_platform_and_commit(name):
    """A row that several runs share names all of theirs."""
    for row in tables.rows(name):
        assert set(row["engine"].split(" ")) <= {"host", "native", "openmm"}, row
        assert row["platform"] in ("CPU", "OpenCL", "Reference"), row
        assert re.fullmatch(r"[0-9a-f]{8}( [0-9a-f]{8})*", row["commit"]), row


def test_the_default_has_at_most_two_fifths_of_the_energy_error_of_verlet_for_one_force_a_step():
    assert tables.over_verlet("W2_1") < 0.4
    stds, ratios = tables.default_energies()
    assert max(ratios) < 0.4
    measured = page("docs/explanation/benchmarks.md")
    assert f"over 30 ps of {min(stds):.3f} to {max(stds):.3f} kJ/mol from four starts" in measured
    assert len(stds) == 4
    assert f"This is {min(ratios):.2f} to {max(ratios):.2f} of that of `VerletIntegrator(2 fs)`" in measured
    waters = [row for row in tables.rows("default_energies") if row["system"] == "water"]
    assert max(float(row["evaluations_per_ps"]) for row in waters) <= 515.0


@pytest.fixture(scope="module")
def known():
    return write_tables.all_tables()


@pytest.mark.parametrize("page", write_tables.pages(), ids=lambda page: page.name)
def test_tables_of_a_page_are_those_of_the_records(page, known):
    text = page.read_text(encoding="utf-8")
    assert text == write_tables.written(text, known), "run python benchmarks/write_tables.py"


def test_every_scheme_is_in_the_table_or_its_benchmark_is_named():
    """A new scheme needs no other file; the summary of the tests says what is left to do."""
    measured = {row["scheme"] for row in tables.rows("angular_momentum")}
    if missing := [name for name in rb.SCHEMES if name not in measured]:
        script = "benchmarks/schemes/angular_momentum.py"
        pytest.skip(f"for the table of schemes, run {script} --schemes {' '.join(missing)} and write_tables.py")


def test_the_angular_momentum_is_conserved_as_the_record_has_it():
    changes = {row["scheme"]: row["change"] for row in tables.rows("angular_momentum")}
    of_output = {name: changes.pop(name) for name in ("W2_1", "W4_4")}
    text = page("docs/reference/schemes.md")
    assert f"molecules is conserved to {max(changes.values(), key=float)} over 30 ps" in text
    assert "except with `W2_1` ({W2_1}) and `W4_4` ({W4_4})".format(**of_output) in text


def test_a_table_without_a_record_is_an_error():
    with pytest.raises(ValueError, match=r"the table nobody_s .*: write benchmarks/records/nobody_s\.csv"):
        write_tables.made("nobody_s")


def test_a_table_is_written_again_below_its_name():
    page = "a\n\n<!-- table: t -->\n| old |\n| - |\n\nb\n"
    assert write_tables.written(page, {"t": "| new |\n| --- |"}) == page.replace("| old |\n| - |", "| new |\n| --- |")


def test_each_table_has_rows_as_wide_as_its_head(known):
    for name, text in known.items():
        head, _, *body = text.splitlines()
        assert body, name
        assert {len(re.findall(r"\|", line)) for line in body} == {head.count("|")}, name


@pytest.mark.parametrize(("value", "text"), [(22.74, "23"), (0.287, "0.3"), (3.97, "4")])
def test_figures_have_two_digits_and_one_below_one(value, text):
    assert tables.rounded(value) == text


def test_figures_of_the_protein_tutorial_are_those_of_the_records():
    measured = page("docs/explanation/any-molecule.md")
    theirs, ours = tables.populations().values()
    assert f"is {ours['helical']} with `W2_3m` at 8 fs, and {theirs['helical']} with" in measured
    assert f"their population, {ours['left']} and {theirs['left']}, to be determined" in measured
    assert f"The energies of bonds are {ours['bonds']} and {theirs['bonds']} kJ/mol" in measured
    villin = [run for run in tables.rows("protein_steps") if run["solute"] == "villin"]
    at_8_fs, at_4_fs = (
        [run for run in villin if (run["integrator"], run["fs"], run["friction"]) == (integrator, fs, "5.0")]
        for integrator, fs in (("W2_3m", "8.0"), ("LangevinMiddle", "4.0"))
    )
    assert tables.ended(at_8_fs) == "9 of 9 runs of 100 ps"
    temperature = tables.mean_of(at_8_fs, "T_solute", 1)
    assert f"The temperature of villin in water is {temperature} K, the mean of nine runs" in measured
    energies = (tables.mean_of(some, "U", 2) for some in (at_8_fs, at_4_fs))
    assert "with villin is {} kJ/mol per molecule of water, and {} kJ/mol with".format(*energies) in measured
    for integrator, fs in (("W2_3m", "8.0"), ("W2_3m", "4.0"), ("LangevinMiddle", "2.0")):
        runs = tables.rows("protein_steps")
        at_pressure = [
            run for run in runs if (run["integrator"], run["fs"], run["ensemble"]) == (integrator, fs, "NPT")
        ]
        assert f"{tables.mean_of(at_pressure, 'density', 1)} kg/m³ in" in measured


def test_averages_at_long_steps_agree_with_those_of_openmm_in_the_limit_of_short_steps():
    of_point = {"integrator": "LangevinMiddle", "fs": "2.0", "solute": "peptide", "masses": "all", "ensemble": "NVT"}
    theirs = [row for row in tables.rows("protein_steps") if of_point.items() <= row.items()]
    limits = tables.protein_limits()
    for name, ((limit, error), _) in limits.items():
        values = np.array([float(row[name]) for row in theirs])
        assert abs(limit - values.mean()) < 2.0 * math.hypot(error, values.std(ddof=1) / math.sqrt(len(values))), name
    hotter, higher = (with_error(*limits[name][1], digits) for name, digits in (("T_solute", 2), ("U", 3)))
    words = f"the peptide increases by {hotter} K, and the potential energy by {higher} kJ/mol"
    assert words in page("docs/explanation/any-molecule.md")


def test_the_gain_of_dipoles_is_that_of_the_record():
    least, most = droplet_gains()
    for name in ("README.md", "docs/which.md"):
        assert f"{round(least, -1):g} to {round(most, -1):g} times less energy error" in page(name)


def test_the_memory_of_dipoles_is_that_of_the_record():
    page = (ROOT / "docs" / "explanation" / "dipoles-measured.md").read_text(encoding="utf-8")
    assert f"A process takes {dipole_memory()}." in page


def test_errors_of_ewald_sums_of_dipoles_are_below_the_tolerance():
    """As the page says."""
    assert largest_error() < 1.0


def test_the_drift_of_dipoles_is_that_of_the_record():
    first = [row for row in tables.rows("dipole_energy") if (row["scheme"], row["start"]) == ("S6_10", "0")]
    mesh, direct = (f"{row['drift_a_ps']} ± {row['drift_error']}".replace("e-0", "e-") for row in first)
    words = f"is {mesh} kJ/mol per dipole and ps over {first[0]['ps']} ps with the mesh, and {direct} over"
    assert words.replace(" -", " −") in page("docs/explanation/dipoles-measured.md")


def test_the_potential_energy_of_w2_3m_is_that_at_the_reading_point():
    """At 4 fs."""
    above = [row.split("|")[3].split("±")[0].strip() for row in reading_points().splitlines() if "above" in row]
    words = f"that is {min(above)} to {max(above)} kJ/mol per molecule too high at 4 fs"
    assert words in page("docs/which.md")


def test_verlet_at_twice_the_cost_is_compared_with_the_default_in_the_record():
    found = tables.rows("default_energies")

    def gain(system, start):
        """Return the error of Verlet at 2 fs over that of the default at 4 fs."""
        std = {
            key: [
                float(row["std_kJ_mol"])
                for row in found
                if (row["system"], row["start"], row["integrator"], row["fs"]) == (system, start, *key)
            ]
            for key in (("Verlet", "2.0"), ("default", "4.0"))
        }
        theirs, ours = std.values()
        return len(ours), sum(theirs) / sum(ours)

    (one, villin), (two, peptide) = gain("villin", "file"), gain("peptide", "equilibrated")
    assert (one, two) == (1, 2)
    assert (
        f"has {villin:.1f} times the energy error for villin (one run of 0.2 ps) and {peptide:.1f} times for"
        in page("docs/which.md")
    )


def test_openmm_at_8_fs_is_as_the_record_has_it_with_the_runs_that_ended():
    head, _, *body = (
        [cell.strip() for cell in line.split("|")[1:-1]] for line in tables.equal_protein_costs().splitlines()
    )
    _, theirs, ours, _ = (dict(zip(head, row, strict=True)) for row in body)
    which = page("docs/which.md")
    assert f"{theirs['ended']} of alanine dipeptide in water ended" in which
    for words, name in (
        ("peptide is {} K, and reported as", "T_peptide (K)"),
        ("K, and reported as {} K", "T_peptide reported (K)"),
        ("rotation of water is {} K, and reported as", "T_rot (K)"),
        ("K, and reported as {} K", "T_rot reported (K)"),
    ):
        assert words.format(theirs[name]) in which
    for text in (which, *map(page, ("docs/tutorials/protein-8fs.md", "README.md", "docs/index.md"))):
        assert f"{ours['ended']} ended" in text
    assert f"is {ours['U (kJ/mol per molecule of water)']} kJ/mol per molecule of water, and −40.68 ± 0.01" in which
    assert body[0][-1] == "−40.68 ± 0.01"
    assert f"at the temperature of the thermostat ({ours['T_peptide (K)']} K)" in which
    excess, error = theirs["T_peptide (K)"].split(" ± ")
    for name in ("README.md", "docs/index.md"):
        assert f"is then {float(excess) - 300.0:.1f} ± {error} K too hot" in page(name)
    measured = page("docs/explanation/any-molecule.md")
    assert f"its rotation at {ours['T_rot (K)']} K, and the peptide at {ours['T_peptide (K)']} K" in measured
    reported = [name for name in head if "reported" in name]
    assert 8.5 < max(float(theirs[name].split()[0]) for name in reported) - 300.0 < 9.0  # up to 9 K
    assert max(abs(float(ours[name].split()[0]) - 300.0) for name in reported) < 1.0
    asked = {"masses": "all", "constraints": "HBonds", "fs": "8.0", "friction": "5.0", "picoseconds": "100.0"}
    watery = [
        row
        for row in tables.rows("protein_steps")
        if row["integrator"] == "W2_3m" and {name: row[name] for name in asked} == asked
    ]
    assert f"{tables.ended(watery)} ended" in which
    light = [row for row in tables.rows("protein_steps") if (row["integrator"], row["fs"]) == ("LangevinMiddle", "6.0")]
    assert tables.ended(light) == "0 of 3 runs of 100 ps"
    assert "none of three runs of `LangevinMiddleIntegrator` at 6 fs ended" in page("docs/explanation/any-molecule.md")


def test_the_reciprocal_part_in_outer_steps_gains_nothing_at_the_same_cost():
    """A method without inner steps that costs no more is at least as accurate."""
    found = [(row["method"], float(row["s_per_ps"]), float(row["std"])) for row in tables.rows("reciprocal")]
    plain, inner = ([row for row in found if (" in " in row[0]) == has] for has in (False, True))
    assert inner
    for _, cost, std in inner:
        assert min(its for _, least, its in plain if least <= cost) <= std


def test_molecules_with_constrained_rings_have_the_temperature_of_the_thermostat():
    """Each within two standard errors, and at either step the mean that the page has."""
    found = [row for row in tables.rows("martini_rings") if row["T_K"] != "nan"]
    assert len({row["molecule"] for row in found}) == 10
    assert all(abs(float(row["T_K"]) - 310.0) < 2.0 * float(row["error_K"]) for row in found)
    for step in "20", "30":
        T, error = np.array(
            [(row["T_K"], row["error_K"]) for row in found if (row["step_fs"], row["integrator"]) == (step, "exact")],
            dtype=float,
        ).T
        mean = tables.with_error(np.average(T, weights=error**-2), np.sum(error**-2) ** -0.5, 2)
        assert f"mean is {mean} K at each step size" in page("docs/tutorials/cholesterol.md")


def test_what_smooth_forces_cost_is_in_the_record():
    small, large = map(costs_of_settings, ("216", "895"))
    most, least = (f"{costs['switch and tolerance 1e-5']:.1f}" for costs in (small, large))
    assert f"with this setting alone, a step takes {small['switch']:.2f} times as long" in page("docs/faq.md")
    words = f"of 895 molecules takes {least} times as long, and one of 216 molecules {most} times as long"
    assert words in page("docs/faq.md")


def test_what_a_call_of_one_step_costs_is_in_the_record():
    least, most = more_for_a_call()
    words = f"A call of `step(1)` takes {least:.0f} to {most:.0f} µs longer"
    assert words in page("docs/explanation/benchmarks.md")


def test_the_cost_of_water_from_27_molecules_on_is_in_the_record():
    few = "1 TIP3P", "8 TIP3P"
    waters = [
        row for row in tables.rows("small_systems") if row["system"].endswith(" TIP3P") and row["unit"] == "ratio"
    ]
    most = max(float(row["median"]) for row in waters if row["system"] not in few and "two threads" not in row["run"])
    assert f"from 27 molecules on, that of water is at most {most:.2f}" in page("docs/explanation/benchmarks.md")


def test_the_cost_of_alchemical_systems_is_in_the_record():
    ratios = alchemical_systems()
    text = page("docs/how-to/replica-exchange.md")
    assert f"{ratios['CPU', 'W2_3m']} (`W2_3m`) and {ratios['CPU', 'BAOA']} (`BAOA`) times as long" in text
    assert f"and {ratios['OpenCL', 'W2_3m']} and {ratios['OpenCL', 'BAOA']} times on PoCL" in text


def page(name):
    """Return the words of a page, one space apart."""
    return " ".join((ROOT / name).read_text(encoding="utf-8").split())
