"""The library: who may write where it is stored, what its name depends on, and what its functions refuse."""

import ctypes
import shutil
import stat
from pathlib import Path

import openmm
import pytest

from openmm_exactrb.errors import MissingLibraryError
from openmm_exactrb.library import compilation
from openmm_exactrb.library import library as module
from openmm_exactrb.library.library import Machine, library

pytestmark = pytest.mark.library

ROOT = Path(__file__).parents[2]
needs_compiler = pytest.mark.skipif(shutil.which("c++") is None, reason="needs a C++ compiler")


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """Return a folder for compiled libraries that does not exist yet."""
    folder = tmp_path / "cache"
    monkeypatch.setenv(module.CACHE, str(folder))
    return folder


def test_without_a_home_folder_a_sentence_names_the_variable(monkeypatch):
    """As for a user of a container who has neither an entry nor HOME."""
    for name in (module.CACHE, "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)

    def homeless():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(module.Path, "home", homeless)
    with pytest.raises(MissingLibraryError, match=f"no home folder .*: set the environment variable {module.CACHE} to"):
        module.private_folder()


@needs_compiler
def test_the_folder_belongs_to_the_user_alone(cache):
    assert stat.S_IMODE(module.private_folder().stat().st_mode) == 0o700
    cache.chmod(0o755)
    with pytest.raises(MissingLibraryError, match="other users have access to it"):
        module.private_folder()


@needs_compiler
def test_what_another_user_could_have_written_is_not_loaded(cache):
    module.private_folder()
    planted = module.cached()
    planted.write_bytes(b"")
    planted.chmod(0o666)
    with pytest.raises(MissingLibraryError, match="other users have access to it"):
        module.compiled()


@needs_compiler
def test_names_tell_texts_compilers_and_versions_apart(cache, tmp_path, monkeypatch):
    names = [module.cached().name]
    for files in ("SOURCES", "INCLUDED"):  # any of which is edited
        for file in getattr(compilation, files):
            edited = tmp_path / file.name
            edited.write_bytes(file.read_bytes() + b"\n")
            others = tuple(edited if other == file else other for other in getattr(compilation, files))
            with monkeypatch.context() as patch:
                patch.setattr(compilation, files, others)
                names.append(module.cached().name)
    flags = tmp_path / "compilation.py"
    flags.write_text(Path(compilation.__file__).read_text(encoding="utf-8").replace("-O3", "-O2"), encoding="utf-8")
    compiler = tmp_path / "compiler"
    compiler.write_text('#!/bin/sh\nexec c++ "$@"\n')
    compiler.chmod(0o700)
    with monkeypatch.context() as patch:
        patch.setattr(compilation, "__file__", str(flags))
        names.append(module.cached().name)
    with monkeypatch.context() as patch:
        patch.setenv(compilation.COMPILER, str(compiler))
        names.append(module.cached().name)
    monkeypatch.setattr(openmm, "__version__", "8.6.9")
    names.append(module.cached().name)
    assert "openmm8.6.9" in names[-1]
    assert len(set(names)) == len(names) > len(compilation.SOURCES) + len(compilation.INCLUDED)


@needs_compiler
def test_without_a_program_it_is_a_custom_integrator():
    integrator = library().make()
    assert type(integrator) is openmm.CustomIntegrator
    assert library().owns(integrator)
    assert not library().owns(openmm.CustomIntegrator(0.001))
    integrator.setStepSize(0.001)
    integrator.addComputePerDof("x", "x+1")
    system = openmm.System()
    system.addParticle(1.0)
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
    context.setPositions([[0.0, 0.0, 0.0]])
    integrator.step(2)
    assert context.getState(positions=True).getPositions()[0][1]._value == 2.0


@needs_compiler
def test_lines_that_are_no_program_are_refused_with_a_sentence():
    integrator = library().make()
    device = Machine(library(), integrator)  # which does not keep the integrator alive
    for text, message in (
        ("run nothing", "an operation outside a sequence: run nothing"),
        ("sequence a\nrun nothing", "no kernel nothing"),
        ("sequence a\njump", "unknown operation jump"),
        *(
            (f"sequence a\n{word}", f"incomplete operation {word}")
            for word in ("run", "forces", "clock", "add", "copy")
        ),
    ):
        with pytest.raises(openmm.OpenMMException, match=message):
            device.load(text)
    with pytest.raises(openmm.OpenMMException, match=r"no Context on a processor .* or no program"):
        device.step(1)
    with pytest.raises(openmm.OpenMMException, match="no array x"):
        device.upload("x", ctypes.c_double())


def test_the_info_says_which_library_runs(capsys):
    from openmm_exactrb.command.main import main

    assert main(["info"]) == 0
    assert f"native engine: {module.describe()}" in capsys.readouterr().out
