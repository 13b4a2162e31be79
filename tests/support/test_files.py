"""Files are there whole or not at all."""

import contextlib

import openmm_exactrb as rb


def test_a_file_written_whole_is_there_only_when_it_is_complete(tmp_path):
    file = tmp_path / "file"
    for old in (None, "old"):
        with contextlib.suppress(ZeroDivisionError), rb.written_whole(file) as out:
            out.write("new")
            raise ZeroDivisionError
        assert [f.name for f in tmp_path.iterdir()] == ([] if old is None else ["file"])
        with rb.written_whole(file) as out:
            out.write("old")
        assert file.read_text(encoding="utf-8") == "old"
